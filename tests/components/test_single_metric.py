"""Metrics written for one run."""

import numpy as np
from components.one_run import TS, Fixed, N, designed, experiment, simulated
from conftest import EXACT, ROUND

from rmpc_bench import Metric
from rmpc_bench.components.single_run import design_function, single_run
from rmpc_bench.config_file.keys import keys_of
from rmpc_bench.metrics.tracking import Mse
from rmpc_bench.types import Positive, Status


@single_run
def overshoot(y, r, limit: float = 0.0):
    """Largest output beyond the reference."""
    return max(limit, (y - r).max())


@single_run
class PeakError:
    """The largest error of the estimate, with P and time."""

    better, unit, needs_info = "lower", "m", ("cost",)

    def __init__(self, factor: float = 1.0):
        self.factor = factor

    def evaluate(self, x, x_hat, P, t, Ts, info):
        """Use all of them."""
        assert P.shape == (N + 1, 2, 2) and Ts == TS and t[-1] == N * TS
        return self.factor * np.abs(x - x_hat).max()


def test_a_metric_of_one_run():
    """Oracle: the formulas on the recorded trajectories; the name is that of the function, or as given."""
    mine = (designed("metrics", overshoot, limit=0.5), designed("metrics", PeakError, name="peak", factor=2.0))
    _, metrics, traces, _ = simulated(experiment(metrics=mine))
    np.testing.assert_allclose(metrics[0], np.maximum(0.5, (traces["y"][..., 0] - 1.0).max(axis=1)), **ROUND)
    np.testing.assert_allclose(metrics[1], 2.0 * np.abs(traces["x"] - traces["x_hat"]).max(axis=(1, 2)), **ROUND)
    infos = [each.info(experiment().metric_layout) for each in mine]
    assert [(each.name, each.unit) for each in infos] == [("overshoot", ""), ("peak", "m")]
    assert designed("metrics", PeakError).name == "peak_error" and mine[1].needs_info == ("cost",)


@single_run
class Dying(Fixed):
    """An estimator that dies in run 1."""

    def update(self, run, k):
        """Die at k = 2."""
        if (run, k) == (1, 2):
            raise ValueError("gone")
        return self.x


CALLS = []


@single_run
def fragile(y, run=None):
    """Fail for one run."""
    CALLS.append(len(y))
    if len(CALLS) == 2:
        raise ZeroDivisionError("division by zero")
    return 1.0


def test_a_metric_that_fails_costs_its_run_and_is_not_called_for_failed_runs():
    """Oracle: five calls for six runs of which one has died; the second one raises."""
    CALLS.clear()
    fragile_metric = designed("metrics", single_run(lambda y: fragile(y)), name="fragile")
    status, metrics, _, (journal,) = simulated(
        experiment(designed("estimators", Dying), metrics=(fragile_metric, Mse()))
    )
    assert len(CALLS) == 5 and status.tolist() == [0, Status.CRASHED, Status.CRASHED, 0, 0, 0]
    assert journal.failures[1].component == "estimator"
    assert (journal.failures[2].component, journal.failures[2].message) == (
        "metric",
        "ZeroDivisionError: division by zero",
    )
    assert np.isnan(metrics[:, 1:3]).all() and np.isfinite(metrics[:, [0, 3, 4, 5]]).all()


class PeakOutput(Metric):
    """A batch metric with a key, and nothing else."""

    factor: Positive = 1.0

    def evaluate(self, record):
        """Return one value per run."""
        return self.factor * record.y.max(axis=(1, 2))


def test_a_class_derived_from_metric_needs_no_decorator():
    """Oracle: the formula; the key is checked, the name is that of the class unless it is given."""
    mine = designed("metrics", PeakOutput), designed("metrics", PeakOutput, name="twice", factor=2.0)
    assert [each.name for each in mine] == ["peak_output", "twice"]
    _, metrics, traces, _ = simulated(experiment(metrics=mine))
    np.testing.assert_allclose(metrics[0], traces["y"].max(axis=(1, 2)), **EXACT)
    np.testing.assert_allclose(metrics[1], 2.0 * metrics[0], **EXACT)
    assert list(keys_of("metrics", "mine", design_function("metrics", PeakOutput)).model_fields) == [
        "name",
        "label",
        "factor",
    ]


def test_an_answer_that_is_no_number_is_a_crash():
    """Oracle: the sentence; NaN and inf are values of a metric."""
    for value, message in ([1.0, 2.0], "evaluate returned [1.0, 2.0]; one number is expected"), (np.inf, None):
        metric = designed("metrics", single_run(lambda y, value=value: value), name="mine", value=value)
        status, metrics, _, (journal,) = simulated(experiment(metrics=(metric,), n_runs=1))
        assert status[0] == (Status.CRASHED if message else 0)
        assert journal.failures[0].message == message if message else metrics[0, 0] == np.inf
