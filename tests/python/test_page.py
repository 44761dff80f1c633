"""docs/python.md: its code runs from top to bottom, and its names are public."""

import re
from pathlib import Path

import rmpc_bench

PAGE = (Path(__file__).parents[2] / "docs" / "python.md").read_text(encoding="utf-8")


def test_the_code_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    space = {"__name__": "__main__"}
    for code in re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL):
        exec(code, space)
    assert (tmp_path / "boxplot.svg").exists() and "mine" in space["results"].trials.methods
    loop = PAGE.partition("## A loop")[2].partition("```python\n")[2].partition("```")[0]
    assert len(loop.splitlines()) <= 10


def test_the_names_of_the_table_are_public():
    names = [name for row in re.findall(r"^\| (`.*?) \|", PAGE, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)]
    assert len(names) >= 15 and {*names} <= {*rmpc_bench.__all__}
