"""The trials as figures show them."""

import numpy as np
import pytest
from small_experiment import write

from rmpc_bench import load_config, run
from rmpc_bench.analysis.rounding import rounded
from rmpc_bench.analysis.trial_arrays import rounded_trials


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """Return a sweep of two points with recorded runs."""
    directory = tmp_path_factory.mktemp("rounded")
    config = load_config(write(directory, record="{runs: 2}", sweep="{grid: {controller.Hu: [3, 8]}}"))
    return run(config, directory=directory / "out", jobs=1).trials


def test_every_number_has_six_digits(trials):
    """Of the whole table and of every point; texts, counts and the original stay."""
    before = trials.points[0].frame.copy()
    found = rounded_trials(trials)
    for old, new in zip([trials, *trials.points], [found, *found.points], strict=True):
        for info in old.metrics:
            assert new.frame[info.name].tolist() == rounded(old.frame[info.name].to_numpy()).tolist()
        assert new.frame[["method", "run", "status"]].equals(old.frame[["method", "run", "status"]])
        assert new.series["value"].tolist() == rounded(old.series["value"].to_numpy()).tolist()
        assert new.series.drop(columns="value").equals(old.series.drop(columns="value"))
        for method, traces in old.traces.items():
            assert np.array_equal(new.traces[method].signals["y"], rounded(traces.signals["y"]))
    assert trials.points[0].frame.equals(before)


def test_points_share_what_they_shared(trials):
    """The series of an estimator that is the same at both points exist once."""
    for table in (trials, rounded_trials(trials)):
        pairs = list(zip(*(point.over_time for point in table.points), strict=True))
        assert len(pairs) > 2 and all(one.values is other.values for one, other in pairs)
