"""docs/tutorial.md, followed literally in an empty directory."""

from pathlib import Path

import pytest
from docs.followed_page import comparable, follow

PAGE = Path(__file__).parents[2] / "docs" / "tutorial.md"


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    return list(follow(PAGE, tmp_path_factory.mktemp("tutorial")))


def test_every_command_works(steps):
    assert 4 <= len(steps) <= 10
    for step in steps:
        assert step.code == 0, f"{step.line}\n{step.out}{step.err}"
        assert "Traceback" not in step.err


def test_the_page_shows_what_is_printed(steps):
    """Made again by `python -m tests.docs.followed_page docs/tutorial.md`."""
    shown = [step for step in steps if step.shown is not None]
    assert len(shown) >= 2
    for step in shown:
        assert comparable(step.out) == step.shown, f"docs/tutorial.md is stale: {step.line}"


def test_the_quickstart_of_the_page_exists():
    assert "configs/quickstart.yaml" in PAGE.read_text("utf-8")
    assert (PAGE.parents[1] / "configs" / "quickstart.yaml").is_file()
