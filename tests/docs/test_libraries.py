"""docs/libraries.md, followed literally: every section in a directory of its own, where its libraries are installed."""

import re
from pathlib import Path

import pandas as pd
import pytest
from docs.followed_page import BLOCK, comparable, follow

from rmpc_bench.analysis.shown_numbers import Estimate, change_texts, mean_text, plain
from rmpc_bench.extras import EXTRAS, is_installed

PAGE = Path(__file__).parents[2] / "docs" / "libraries.md"
SECTIONS = {
    text.partition("\n")[0]: text for text in re.split(r"^## ", PAGE.read_text("utf-8"), flags=re.MULTILINE)[1:]
}
FIRST = "Ten commands"
FOLLOWED = [title for title, text in SECTIONS.items() if re.search(r"^```console", text, re.MULTILINE)]
LIBRARY = re.compile(r"\b(" + "|".join({*EXTRAS.values()} - {"control"}) + r")\b|import control\b|\{control:")

NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


def extras_of(text):
    """Extras of which the blocks of a section use the library."""
    code = "\n".join(block for _, _, block in BLOCK.findall(text))
    names = {found[1] or "control" for found in LIBRARY.finditer(code)}
    return [extra for extra, module in EXTRAS.items() if module in names]


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    """Return a function that follows a section, once."""
    known = {}

    def followed(title):
        missing = [extra for extra in extras_of(SECTIONS[title]) if not is_installed(extra)]
        if missing:
            pytest.skip(f"needs {', '.join(missing)}")
        if title not in known:
            place = tmp_path_factory.mktemp("section")
            (place / "section.md").write_text(SECTIONS[title], encoding="utf-8")
            known[title] = place, [*follow(place / "section.md", place)]
        return known[title]

    return followed


@pytest.mark.page("libraries")
@pytest.mark.parametrize("title", FOLLOWED)
def test_every_command_works(steps, title):
    for step in steps(title)[1]:
        assert step.code == 0, f"{step.line}\n{step.out}{step.err}"
        assert "Traceback" not in step.err


@pytest.mark.page("libraries")
def test_ten_commands_lead_to_a_comparison(steps):
    """With the installation they are at most ten, and all three methods have finished."""
    place, done = steps(FIRST)
    installation = re.findall(r"^make setup (.*)$", SECTIONS[FIRST], re.MULTILINE)
    assert installation == ["EXTRAS=dev,filterpy,do-mpc"]
    assert len(done) + len(installation) <= 10
    verbs = [step.line.split()[1] for step in done]
    assert verbs[0] == "init" and {"check", "run", "report", "show"} < {*verbs}
    summary = (place / "results" / "theirs" / "summary.csv").read_text("utf-8")
    assert all(f"\n{name}," in summary for name in ("Kalman", "do-mpc", "filterpy"))
    assert (place / "results" / "theirs" / "figures" / "boxplot.svg").is_file()


@pytest.mark.page("libraries")
def test_the_screen_of_the_page(steps):
    """It is printed as it stands there; the time, and last digits, differ between machines."""
    step = next(step for step in steps(FIRST)[1] if step.shown is not None)
    shown, printed = (comparable(text).partition("\n")[2] for text in (step.shown, step.out))
    words, same = (
        [re.sub(r"[-+]?[\d.]+", "#", line).split() for line in text.splitlines()] for text in (shown, printed)
    )
    assert words == same
    numbers, close = ([float(number) for number in NUMBER.findall(text)] for text in (shown, printed))
    assert numbers == pytest.approx(close, rel=0.02, abs=0.15) and len(numbers) > 10


def kept(name):
    """Return method -> row of the primary metric in a table of the kept results of configs/examples/libraries.yaml."""
    table = pd.read_csv(PAGE.parents[1] / "results" / "examples" / "libraries" / f"{name}.csv")
    return table[table.metric == "mse"].set_index("method").to_dict("index")


def test_the_table_of_four_libraries():
    """Oracle: the kept results, from the smallest change to the largest, the baseline in its place."""
    means, changes = kept("summary"), kept("comparisons")
    made = []
    for name in sorted(means, key=lambda name: changes[name]["change_pct"] if name in changes else 0.0):
        row, found = means[name], changes.get(name)
        cells = [name, mean_text(Estimate(row["mean"], row["ci_low"], row["ci_high"]))]
        cells += (
            [" ".join(change_texts(Estimate(found["change_pct"], found["ci_low"], found["ci_high"])))] if found else []
        )
        made.append([*map(plain, cells), found["verdict"] if found else "baseline"])
    (block,) = (text for _, _, text in BLOCK.findall(SECTIONS["One comparison with four libraries"]) if "MHE" in text)
    assert [re.split(r" {2,}", line.strip()) for line in block.splitlines()[1:]] == made


def test_every_library_has_a_section_with_its_extra():
    text = PAGE.read_text("utf-8")
    for extra in EXTRAS:
        assert f"`[{extra}]`" in text
