"""Pages that are followed literally in an empty directory; test_generated_pages.py compares what is printed."""

import os
import re
import shutil
import subprocess
import sys

import pandas as pd
import pytest
from docs.followed_page import BLOCK, FOLLOWED, SHORT, TUNING, TUTORIAL, comparable, cut, follow, followed
from docs.markdown import DOCS

from rmpc_bench import load_config, load_results
from rmpc_bench.components.user_class import MEANINGS
from rmpc_bench.types import ConfigError

OWN, LIMITS = DOCS / "own-components.md", DOCS / "constraints.md"
PAGES = [pytest.param(page, marks=pytest.mark.page(page.stem), id=page.stem) for page in (*FOLLOWED[1:], OWN, LIMITS)]


@pytest.mark.parametrize("page", PAGES)
def test_every_command_works(page):
    steps = followed(page).steps
    assert (page == OWN or any(step.shown is not None for step in steps)) and len(steps) <= 10
    for step in steps:
        assert step.code == 0, f"{step.line}\n{step.out}{step.err}"
        assert "Traceback" not in step.err


def test_the_quickstart_of_the_tutorial_exists():
    assert "configs/quickstart.yaml" in TUTORIAL.read_text("utf-8")
    assert (TUTORIAL.parents[1] / "configs" / "quickstart.yaml").is_file()


@pytest.mark.page("tutorial")
@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="LaTeX is not installed")
def test_the_document_of_the_tutorial_compiles():
    place = followed(TUTORIAL).place
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert (place / "paper.pdf").stat().st_size > 10_000


@pytest.mark.page("tuning")
def test_what_the_page_on_tuning_says_of_its_results():
    """The default has the largest error and the tuned Kalman filter the smallest mean; the method without a range."""
    trials = load_results(followed(TUNING).place / "results" / "fair").trials
    means = {name: trials.column("estimation_mse", name).mean() for name in trials.methods}
    assert min(means, key=means.get) == "Kalman" and max(means, key=means.get) == "default"
    assert trials.parameters["default"] == "default"
    assert trials.parameters["robust"] == "tuned (budget 16, 20 runs)"


@pytest.mark.page("tuning")
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


@pytest.mark.page("own-components")
def test_few_commands_lead_to_an_own_estimator_on_an_own_plant():
    """`init`, `check --component` and `run` are the first three; every experiment has a figure."""
    place, steps = followed(OWN)
    verbs = [step.line.split()[1] for step in steps]
    assert verbs[:3] == ["init", "check", "run"] and 7 <= len(verbs) <= 10
    for name in ("smoke/tanks", "filters", "parts", "water"):
        assert (place / "results" / name / "figures" / "boxplot.svg").exists()


@pytest.mark.page("own-components")
def test_the_tests_of_the_page_on_own_components_pass():
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_filters.py"]
    done = subprocess.run(command, cwd=followed(OWN).place, capture_output=True, text=True, env=dict(os.environ))
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout[-3000:]


def test_every_name_of_the_page_on_own_components_is_a_standard_name():
    rows = re.findall(r"^\| (`.*?`) \|", OWN.read_text(encoding="utf-8"), re.MULTILINE)
    names = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert {name for name in names if name not in MEANINGS} <= {"crashed"}
    assert {"y", "u_previous", "rng", "plant_info", "prepared"} <= names


@pytest.mark.page("constraints")
def test_the_ranks_of_the_page_on_constraints():
    place, steps = followed(LIMITS)
    (shown,) = (step for step in steps if step.shown is not None)
    assert comparable(shown.out) == comparable(shown.shown) and len(steps) == 3
    assert (place / "results" / "limited" / "figures" / "rows.svg").exists()


@pytest.mark.page("constraints")
def test_an_output_disturbance_is_refused_in_the_words_of_the_page():
    override = "methods.input.model.disturbance.at=output"
    with pytest.raises(ConfigError) as caught:
        load_config(followed(LIMITS).place / "limited.yaml", overrides=[override])
    blocks = BLOCK.findall(LIMITS.read_text("utf-8"))
    (quoted,) = (text for language, _, text in blocks if language == "text" and "detectable" in text)
    assert " ".join(quoted.split()).endswith(caught.value.problems[0].message)
