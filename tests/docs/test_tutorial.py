"""docs/tutorial.md, followed literally in an empty directory; test_generated_pages.py compares what is printed."""

import shutil
import subprocess

import pytest
from docs.followed_page import TUTORIAL, followed


@pytest.fixture(scope="module")
def steps():
    return followed(TUTORIAL).steps


@pytest.mark.page
def test_every_command_works(steps):
    assert 4 <= len(steps) <= 10
    for step in steps:
        assert step.code == 0, f"{step.line}\n{step.out}{step.err}"
        assert "Traceback" not in step.err


@pytest.mark.page
def test_the_page_shows_what_some_commands_print(steps):
    assert sum(step.shown is not None for step in steps) >= 2


def test_the_quickstart_of_the_page_exists():
    assert "configs/quickstart.yaml" in TUTORIAL.read_text("utf-8")
    assert (TUTORIAL.parents[1] / "configs" / "quickstart.yaml").is_file()


@pytest.mark.page
@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="LaTeX is not installed")
def test_the_document_of_the_page_compiles():
    place = followed(TUTORIAL).place
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert (place / "paper.pdf").stat().st_size > 10_000
