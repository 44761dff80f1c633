"""Sentences about drivers."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from comparison_tables import table

from rmpc_bench.report.drivers_table import drivers_table

N = 200


@pytest.fixture
def quantities():
    """One uniform quantity, and one with a value that only 12 runs have."""
    a = np.random.default_rng(0).uniform(-1, 1, N)
    return pd.DataFrame({"run": np.arange(N), "a": a, "g": np.where(np.arange(N) < 12, 1.0, 0.0)})


def test_a_resolved_fifth_is_named_though_another_mean_is_worse(quantities):
    """The 12 runs have the worst mean with a wide interval; the highest fifth of a is resolved."""
    rng = np.random.default_rng(1)
    logs = 0.05 * quantities["a"].to_numpy() - 0.2
    logs[:12] += 0.15 + 0.6 * rng.standard_normal(12)
    values = {"S": np.ones(N) + rng.uniform(size=N)}
    values["M"] = values["S"] * np.exp(logs)
    found = drivers_table(replace(table(values), uncertainty=quantities, primary="m"))
    rows = found.frame[found.frame["method"] == "M"].set_index("quantity")
    assert rows.loc["g", "worst"] > rows.loc["a", "worst"]
    assert (bool(rows.loc["g", "differs"]), bool(rows.loc["a", "differs"])) == (False, True)
    assert any(text.startswith("M improves least on S where a is in its highest fifth") for text in found.sentences)


def test_a_share_of_runs_is_not_written_as_a_metric(quantities):
    """62 % of the runs without the event are not a value of 62 %."""
    a = quantities["a"].to_numpy()
    values = {"S": np.where(a > 0.6, np.inf, 1 + a**2), "M": np.where(a > 0.2, np.inf, 1 + a**2)}
    made = table(values, unit="s", may_not_occur=True)
    text = str(drivers_table(replace(made, uncertainty=quantities[["run", "a"]], primary="m")))
    assert ": share of runs in which m has no value 100.0 % [" in text
    assert ": share of runs in which m has no value against S +" in text
    assert " percentage points [" in text


@pytest.mark.parametrize(
    ("failed", "words"), [(0, "(199 runs, 1 not computed;"), (3, "(196 runs, 3 left out in which")]
)
def test_a_run_that_is_not_computed_is_no_failed_one(quantities, failed, words):
    """The last run of M has no row, as in an experiment that was interrupted."""
    values = {"S": 1 + quantities["a"].to_numpy() ** 2, "M": 1.1 + quantities["a"].to_numpy() ** 2}
    values["M"][:failed] = np.nan
    made = table(values, primary="m", uncertainty=quantities[["run", "a"]])
    found = drivers_table(replace(made, frame=made.frame.iloc[:-1]))
    assert set(found.frame.loc[found.frame["method"] == "M", "n_failed"]) == {failed}
    [sentence] = [text for text in found.sentences if text.startswith("M: of the variance")]
    assert words in sentence and ("left out in which a method failed, 1 not computed;" in sentence) == bool(failed)
