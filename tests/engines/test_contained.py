"""Exceptions and invalid return values of batch components: only the runs in which they occur fail."""

import math
from contextlib import ExitStack, contextmanager
from functools import cache

import numpy as np
import pytest
from conftest import ALL
from engines import misbehaving
from engines.misbehaving import BAD, K_BAD, Level, do_nothing, experiment, tasks_of

from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.choice import serial
from rmpc_bench.simulation.ensemble import joined
from rmpc_bench.store.store import Store

N_RUNS = 60
RIGHT = "it must be an array of numbers (1, 1)"
MESSAGES = {
    "raise_value_error": "ValueError: negative level",
    "exit_by_sys": "SystemExit: 0",
    "interrupt": "KeyboardInterrupt",
    "fail_to_open": "FileNotFoundError: [Errno 2] No such file or directory: '/nowhere/table.csv'",
    "return_wide": f"correct returned x_hat as an array of float64 of shape (1, 2); {RIGHT}",
    "return_list": f"correct returned x_hat as an object of type list; {RIGHT}",
    "return_text": f"correct returned x_hat as an array of <U32 of shape (1, 1); {RIGHT}",
    "return_bad_status": "correct returned the status 77; the statuses are 0 to 9",
    "return_nothing": "correct returned None; it must return (state, x_hat) or (state, Estimate)",
}
"""What a component does -> the failure that is stored."""


def stored(made, dones, directory):
    """Store results as `run` does, each under the name of its method."""
    store = Store(directory)
    for task, block, uncertainty, *_ in dones:
        columns = {metric.name: column for metric, column in zip(made.metrics, block.metrics, strict=True)}
        store.add_block(task.method, task.runs, block, columns, "draw", uncertainty)
    return store


@contextmanager
def stores(compute, n_runs, tmp_path_factory):
    """Yield a function that runs a misbehaviour beside the estimator without one, and returns the store."""
    with ExitStack() as opened:

        @cache
        def store_of(act, *how):
            made = experiment([do_nothing, getattr(misbehaving, act)], n_runs)
            return opened.enter_context(stored(made, compute(made, *how), tmp_path_factory.mktemp(act)))

        yield store_of


@pytest.fixture(scope="module", params=[7, 50])
def store_of(request, tmp_path_factory):
    """Compute in this process, in blocks of so many runs."""

    def compute(made):
        return serial([made], TaskQueue(tasks_of(made, request.param)))

    with stores(compute, N_RUNS, tmp_path_factory) as found:
        yield found


@pytest.mark.parametrize("act", MESSAGES)
def test_only_the_bad_runs_crash(store_of, act):
    """The other runs have the numbers of the same estimator without the misbehaviour, bit for bit."""
    store = store_of(act)
    (runs, words), (_, fine) = store.column(act, N_RUNS), store.column("do_nothing", N_RUNS)
    assert fine == ["ok"] * N_RUNS
    assert words == ["crashed" if run in BAD else "ok" for run in runs]
    good = [run for run in runs if run not in BAD]
    np.testing.assert_array_equal(store.values(act, "mse", good), store.values("do_nothing", "mse", good))
    assert np.isnan(store.values(act, "mse", BAD)).all()
    for signal in ("y", "x_hat"):
        recorded, traces = store.traces(act, signal, 30)
        assert recorded == [run for run in good if run < 30]
        np.testing.assert_array_equal(traces, store.traces("do_nothing", signal, 30)[1][recorded])


@pytest.mark.parametrize("act", MESSAGES)
def test_moments_leave_out_the_bad_runs(store_of, act):
    """The mean over the good runs."""
    store = store_of(act)
    n, mean, _ = joined(store.ensemble(act, N_RUNS))
    recorded, x_hat = store.traces(act, "x_hat", N_RUNS)
    assert n == N_RUNS - len(BAD) and mean.shape == (misbehaving.STEPS + 1, 2) and len(recorded) == 28
    groups = [part for part in store.ensemble(act, 50) if not part.is_single]
    assert [part.n for part in groups] == [48]


@pytest.mark.parametrize(("act", "message"), MESSAGES.items())
def test_the_failure_is_described(store_of, act, message):
    """With component, sample, the frames of its own code and the last signals."""
    store = store_of(act)
    failures = store.failures(act, N_RUNS)
    assert [failure.run for failure in failures] == [*BAD]
    _, x_hat = store.traces("do_nothing", "x_hat", N_RUNS)
    for failure in failures:
        assert (failure.message, failure.component, failure.k) == (message, "estimator", K_BAD)
        assert len(failure.values["y"]) == len(failure.values["u_previous"]) == 1
        assert failure.values["x_hat"] == x_hat[failure.run, K_BAD - 1].tolist()
        # What is returned wrong has no frame of its own; the check of shapes adds some that are not the bench's.
        assert ("closed_loop" in failure.trace) == (act.startswith("return") and not ALL)
        assert (f"in {act}" in failure.trace) == (not act.startswith("return"))
    assert store.failures("do_nothing", N_RUNS) == []
    assert store.failures(act, 20)[0].run == 7 and len(store.failures(act, 20)) == 1


@pytest.mark.parametrize("act", MESSAGES)
def test_what_is_stored_counts_as_finished(store_of, act):
    """A crashed run without trajectories is not computed again."""
    recording = experiment([do_nothing]).recording
    assert store_of(act).finished(act, ["mse"], recording, N_RUNS).tolist() == [*range(N_RUNS)]


def test_a_metric_that_raises(tmp_path):
    """It costs the run, like every component."""
    made = experiment([do_nothing], 30)
    x0 = made.scenario.draw(made.plant, range(30), 1).x0[:, 0]
    made = experiment([do_nothing], 30, metrics=(Level(refused=tuple(x0[[*BAD]])),))
    with stored(made, serial([made], TaskQueue(tasks_of(made, 30))), tmp_path) as store:
        runs, words = store.column("do_nothing", 30)
        assert words == ["crashed" if run in BAD else "ok" for run in runs]
        assert {failure.component for failure in store.failures("do_nothing", 30)} == {"metric"}
        assert store.values("do_nothing", "level", [6, 7])[0] == x0[6]
        assert math.isnan(store.values("do_nothing", "level", [6, 7])[1])
