"""Pages that are followed literally in an empty directory; test_generated_pages.py compares what is printed."""

import re
import shutil
import subprocess

import pandas as pd
import pytest
from docs.followed_page import BLOCK, FOLLOWED, README, SHORT, TUNING, TUTORIAL, cut, follow, followed

from rmpc_bench import load_results

PAGES = [page for page in FOLLOWED if page != README]


@pytest.mark.page
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_works(page):
    steps = followed(page).steps
    assert any(step.shown is not None for step in steps) and len(steps) <= 10
    for step in steps:
        assert step.code == 0, f"{step.line}\n{step.out}{step.err}"
        assert "Traceback" not in step.err


def test_the_quickstart_of_the_tutorial_exists():
    assert "configs/quickstart.yaml" in TUTORIAL.read_text("utf-8")
    assert (TUTORIAL.parents[1] / "configs" / "quickstart.yaml").is_file()


@pytest.mark.page
@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="LaTeX is not installed")
def test_the_document_of_the_tutorial_compiles():
    place = followed(TUTORIAL).place
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert (place / "paper.pdf").stat().st_size > 10_000


@pytest.mark.page
def test_what_the_page_on_tuning_says_of_its_results():
    """The default has the largest error and the tuned Kalman filter the smallest mean; the method without a range."""
    trials = load_results(followed(TUNING).place / "results" / "fair").trials
    means = {name: trials.column("estimation_mse", name).mean() for name in trials.methods}
    assert min(means, key=means.get) == "Kalman" and max(means, key=means.get) == "default"
    assert trials.parameters["default"] == "default"
    assert trials.parameters["robust"] == "tuned (budget 16, 20 runs)"


@pytest.mark.page
def test_the_tuned_values_agree_with_the_trials():
    """Oracle: the mean of the metric over the runs of the experiment is the objective of the tuned value."""
    place = followed(TUNING).place / "results" / "fair"
    table, trials = pd.read_csv(place / "tuning.csv").set_index("method"), load_results(place).trials
    for name in ("Kalman", "fading", "robust"):
        mean = trials.column("estimation_mse", name).mean()
        assert table.loc[name, "test_tuned"] == pytest.approx(mean, rel=2e-5)  # six digits are kept
        assert table.loc[name, "test_best"] <= table.loc[name, "test_tuned"] <= table.loc[name, "test_default"]


def test_what_the_page_on_calibration_says_of_its_table():
    text = next(page for page in SHORT if page.stem == "calibration").read_text("utf-8")
    share, factor = re.search(r"^ Kalman +covers (\d+) % .* errors ([\d.]+) x std", text, re.MULTILINE).groups()
    assert f"in {share} % of the samples only" in " ".join(text.split()) and 1.8 < float(factor) < 2.2


@pytest.mark.parametrize("page", SHORT, ids=lambda page: page.stem)
def test_short_pages_are_short(page):
    words = re.findall(r"[A-Za-z][\w.'-]+", BLOCK.sub("", page.read_text("utf-8")))
    assert 150 <= len(words) <= 400


def test_a_page_without_compared_output_has_fewer_runs(tmp_path, monkeypatch):
    monkeypatch.setenv("RMPC_BENCH_DOC_RUNS", "3")
    assert cut("rmpc-bench run a.yaml") == "rmpc-bench run a.yaml --runs 3"
    for line in ("rmpc-bench run a.yaml --runs 9", "rmpc-bench run a.yaml --missing", "rmpc-bench report results/a"):
        assert cut(line) == line
    page = tmp_path / "page.md"
    page.write_text("```console\n$ python -V\n```\n\n```text\n```\n\n```console\n$ rmpc-bench run a\n```\n", "utf-8")
    assert [step.line for step in follow(page, tmp_path)] == ["python -V", "rmpc-bench run a"]
    page.write_text("```console\n$ rmpc-bench run a\n```\n", "utf-8")
    assert [step.line for step in follow(page, tmp_path)] == ["rmpc-bench run a --runs 3"]
