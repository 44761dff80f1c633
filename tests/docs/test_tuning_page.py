"""docs/tuning.md, followed literally in an empty directory; test_generated_pages.py compares what is printed."""

import pandas as pd
import pytest
from docs.followed_page import TUNING, followed

from rmpc_bench import load_results


@pytest.fixture(scope="module")
def page():
    return followed(TUNING)


@pytest.mark.page
def test_every_command_works(page):
    assert len(page.steps) >= 3
    for step in page.steps:
        assert step.code == 0, f"{step.line}\n{step.out}{step.err}"
        assert "Traceback" not in step.err


@pytest.mark.page
def test_the_run_of_the_page_is_shown(page):
    (shown,) = [step for step in page.steps if step.shown is not None]
    assert (
        shown.line == "rmpc-bench run fair.yaml"
        and " tuned: Kalman V 3.907e-05, fading alpha 1.3088, robust c 0.1866; budget 16," in shown.out
    )


@pytest.mark.page
def test_what_the_page_says_of_its_results(page):
    """The default has the largest error and the tuned Kalman filter the smallest mean; the method without a range."""
    results = load_results(page.place / "results" / "fair")
    means = {name: results.trials.column("estimation_mse", name).mean() for name in results.trials.methods}
    assert min(means, key=means.get) == "Kalman" and max(means, key=means.get) == "default"
    assert results.trials.parameters["default"] == "default"
    assert results.trials.parameters["robust"] == "tuned (budget 16, 20 runs)"


@pytest.mark.page
def test_the_files_agree_with_the_trials(page):
    """Oracle: the mean of the metric over the runs of the experiment is the objective of the tuned value."""
    place = page.place / "results" / "fair"
    table, trials = pd.read_csv(place / "tuning.csv").set_index("method"), load_results(place).trials
    for name in ("Kalman", "fading", "robust"):
        mean = trials.column("estimation_mse", name).mean()
        assert table.loc[name, "test_tuned"] == pytest.approx(mean, rel=2e-5)  # six digits are kept
        assert table.loc[name, "test_best"] <= table.loc[name, "test_tuned"] <= table.loc[name, "test_default"]
    default = trials.column("estimation_mse", "default").mean()
    # The file's value of the Kalman filter is that of the method without a range.
    assert table.loc["Kalman", "test_default"] == pytest.approx(default, rel=2e-5)
