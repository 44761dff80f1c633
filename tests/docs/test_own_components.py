"""docs/own-components.md, followed literally: its files are written, its commands are run."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import forked_commands
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "own-components.md"
BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """Write every named block and run every command, in the order of the page; the directory and what was printed."""
    place, done = tmp_path_factory.mktemp("page"), []
    for language, name, text in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if name:
            (place / name).write_text(text, encoding="utf-8")
        for line in text.splitlines() if language == "console" else ():
            arguments = shlex.split(line.removeprefix("$ rmpc-bench "))
            done.append((line, forked_commands.run(arguments, place)))
    return place, done


def test_every_command_works(followed):
    place, done = followed
    assert len(done) >= 7
    for line, each in done:
        assert each.returncode == 0, f"{line}\n{each.stdout}{each.stderr}"
        assert "Traceback" not in each.stderr
    for name in ("smoke/tanks", "filters", "parts", "water"):
        assert (place / "results" / name / "figures" / "boxplot.svg").exists()


def test_at_most_ten_commands_lead_to_an_own_estimator_on_an_own_plant(followed):
    """`init`, `check --component` and `run` are the first three."""
    verbs = [line.split()[2] for line, _ in followed[1]]
    assert verbs[:3] == ["init", "check", "run"]
    assert len(verbs) <= 10


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
