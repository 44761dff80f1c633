"""docs/own-components.md, followed literally: its files are written, its commands are run."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from docs.followed_page import follow

PAGE = Path(__file__).parents[2] / "docs" / "own-components.md"


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """Write every named block and run every command, in the order of the page; the directory and what was printed."""
    place = tmp_path_factory.mktemp("page")
    return place, [*follow(PAGE, place)]


@pytest.mark.page
def test_every_command_works(followed):
    place, done = followed
    assert len(done) >= 7
    for step in done:
        assert step.code == 0, f"{step.line}\n{step.out}{step.err}"
        assert "Traceback" not in step.err
    for name in ("smoke/tanks", "filters", "parts", "water"):
        assert (place / "results" / name / "figures" / "boxplot.svg").exists()


@pytest.mark.page
def test_at_most_ten_commands_lead_to_an_own_estimator_on_an_own_plant(followed):
    """`init`, `check --component` and `run` are the first three."""
    verbs = [step.line.split()[1] for step in followed[1]]
    assert verbs[:3] == ["init", "check", "run"]
    assert len(verbs) <= 10


@pytest.mark.page
def test_the_tests_of_the_page_pass(followed):
    place = followed[0]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_filters.py"]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True, env=dict(os.environ))
    assert done.returncode == 0, done.stdout[-3000:]
    assert " passed" in done.stdout


def test_every_name_of_the_page_is_a_standard_name():
    from rmpc_bench.components.user_class import MEANINGS

    rows = re.findall(r"^\| (`.*?`) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    names = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert {name for name in names if name not in MEANINGS} <= {"crashed"}
    assert {"y", "u_previous", "rng", "plant_info", "prepared"} <= names
