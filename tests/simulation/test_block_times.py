"""Times of the calls that compute all runs of a block at once."""

from types import SimpleNamespace

import numpy as np
import pytest

from rmpc_bench.simulation import block_times
from rmpc_bench.simulation.block_times import BlockTimes
from rmpc_bench.types import Journal

NONE = np.zeros((1, 1))


@pytest.fixture
def clock(monkeypatch):
    """A clock that the components below move on."""
    now = SimpleNamespace(seconds=0.0)
    monkeypatch.setattr(block_times, "default_timer", lambda: now.seconds)
    return now


def timed(clock):
    """Estimator that takes 3 s and 1 s, and controller that takes 2 s per call."""

    def taking(seconds, answer):
        def call(*_):
            clock.seconds += seconds
            return answer

        return call

    estimator = SimpleNamespace(correct=taking(3.0, ("e", "x_hat")), predict=taking(1.0, "e1"))
    unused = taking(0.0, None)
    controller = SimpleNamespace(control=taking(2.0, ("c", "u")), control_ahead=unused, applied=unused)
    return BlockTimes(estimator, controller)


def test_time_per_run_and_step(clock):
    """The sum over all calls divided by runs and steps, once per run; answers are passed on."""
    calls, journal = timed(clock), Journal()
    for k in range(5):
        assert calls.correct(k, None, NONE) == ("e", "x_hat")
        assert calls.control(k, None, NONE, None, NONE) == ("c", "u")
        assert calls.predict(k, None, NONE) == "e1"
    calls.note(journal, n_runs=10, n_steps=5)
    assert journal.seconds == {"estimator, block": [0.4] * 10, "controller, block": [0.2] * 10}


def test_components_that_are_timed_run_by_run_are_left_out(clock):
    """Their calls are in the journal already."""
    calls, journal = timed(clock), Journal(seconds={"estimator, first step": [1e-3]})
    calls.correct(0, None, NONE)
    calls.control(0, None, NONE, None, NONE)
    calls.note(journal, n_runs=2, n_steps=1)
    assert journal.seconds == {"estimator, first step": [1e-3], "controller, block": [1.0, 1.0]}
