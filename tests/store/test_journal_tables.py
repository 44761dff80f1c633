"""Failures, held steps, warnings and durations in the store."""

import numpy as np
import pytest

from rmpc_bench.simulation.closed_loop import Block
from rmpc_bench.store.rows import WIDTH, Durations
from rmpc_bench.store.store import Store
from rmpc_bench.types import Journal, RunFailure, Status


def add(store, runs, **keys):
    """Store a block of one method with a journal."""
    status = np.zeros(len(runs), dtype=np.int8)
    block = Block(status, np.zeros((1, len(runs))), {}, (), Journal(**keys))
    store.add_block("m", runs, block, {"q": np.zeros(len(runs))}, "d", [{} for _ in runs])


def test_what_is_stored_is_read_again(tmp_path):
    """Of the runs below the number that is asked for."""
    failure = RunFailure(3, int(Status.CRASHED), "plant", 2, "ValueError: no", "  File ...", {"y": [1.0]})
    seconds = {"estimator": [0.001] * 9 + [0.1]}
    with Store(tmp_path) as store:
        add(store, [2, 3], failures={3: failure}, held={2: 4}, warnings={"old": 3, "new": 5}, seconds=seconds)
        assert store.failures("m", 10) == [failure] and store.failures("m", 3) == []
        assert store.held("m", 10) == {2: 4} and store.held("other", 10) == {}
        assert store.warnings("m", 10) == {"new": 5, "old": 3}
        durations = store.durations("m", 10)["estimator"]
        assert durations.n == 10 and durations.largest == 0.1
        assert durations.quantile(0.5) == pytest.approx(0.001, rel=WIDTH)  # the width of a bin


def test_runs_that_are_repeated_replace_the_earlier_ones(tmp_path):
    """Also in other blocks: no call counts twice."""
    failure = RunFailure(1, int(Status.CRASHED), "", None, "gone")
    with Store(tmp_path) as store:
        keys = {"warnings": {"w": 2}, "seconds": {"controller": [1.0]}}
        add(store, [0, 1], failures={1: failure}, held={1: 4}, **keys)
        add(store, [4, 5], **keys)
        add(store, [1], **keys)
        assert store.failures("m", 10) == [] and store.held("m", 10) == {}
        assert store.warnings("m", 10) == {"w": 4} and store.durations("m", 10)["controller"].n == 2


def test_quantiles_of_a_histogram(rng):
    """Oracle: the order statistics of the durations themselves."""
    seconds = np.exp(rng.normal(-6.0, 2.0, 1000))
    found = Durations.of(seconds)
    for share in (0.05, 0.5, 0.95, 1.0):
        exact = np.sort(seconds)[int(np.ceil(share * 1000)) - 1]
        assert found.quantile(share) == pytest.approx(exact, rel=WIDTH)  # the width of a bin
    assert np.isnan(Durations().quantile(0.5))
