"""docs/experiments.md and the short pages: every file is a valid configuration, and the page covers its subject."""

import re
from pathlib import Path

import pytest
from click.testing import CliRunner
from docs.followed_page import BLOCK, SHORT

from rmpc_bench.cli import main

PAGE = Path(__file__).parents[2] / "docs" / "experiments.md"
ALL = {name: text for page in (PAGE, *SHORT) for _, name, text in BLOCK.findall(page.read_text("utf-8")) if name}
FILES = {name: text for name, text in ALL.items() if name.endswith(".yaml")}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("experiments")
    for name, text in ALL.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


@pytest.mark.parametrize("name", FILES)
def test_every_file_is_valid(place, name):
    """`check` also evaluates claims on placeholder data and asks every figure whether it can be drawn."""
    done = CliRunner().invoke(main, ["check", str(place / name)])
    assert done.exit_code == 0, done.output


def test_the_name_of_a_file_is_that_of_its_experiment():
    assert all(re.search(r"^name: (\S+)", text, re.MULTILINE)[1] + ".yaml" == name for name, text in FILES.items())


def test_every_section_of_the_schema_occurs_on_the_page():
    from rmpc_bench.config.sections import SECTIONS

    found = {key for text in FILES.values() for key in re.findall(r"^(\w+):", text, re.MULTILINE)}
    # A paper is named by its configurations, docs/own-components.md has an example of plugins, and a file that requires
    # a library is no valid one where the library is missing.
    assert set(SECTIONS) - found <= {"paper", "plugins", "requires"}
