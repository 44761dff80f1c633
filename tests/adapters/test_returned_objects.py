"""What the function under a decorator returns, where it is not an object of the library."""

import pytest

pytest.importorskip("do_mpc")
pytest.importorskip("filterpy")
pytest.importorskip("stonesoup")

from types import SimpleNamespace

import adapters.filterpy_filters as filters
import numpy as np
from adapters.do_mpc_laws import tracking
from components.one_run import MODEL, START, designed, experiment, simulated
from filterpy.kalman import IMMEstimator, KalmanFilter

from rmpc_bench.adapters.do_mpc import do_mpc_controller, do_mpc_estimator
from rmpc_bench.adapters.filterpy import filterpy_estimator
from rmpc_bench.adapters.stonesoup import stonesoup_estimator
from rmpc_bench.types import Status

FILTER = SimpleNamespace(predict=None, update=None)
MPC, MHE = (SimpleNamespace(make_step=None, **{name: None}) for name in ("set_rterm", "set_y_fun"))


@pytest.mark.parametrize(
    ("decorator", "made", "message"),
    [
        (filterpy_estimator, None, "made returned None; it must return a filter with `predict` and `update`"),
        (filterpy_estimator, (FILTER, 3), "made returned an object of type tuple; it must return a filter"),
        (stonesoup_estimator, 5, "made returned an object of type int; it must return a predictor and an updater"),
        (stonesoup_estimator, (FILTER,), "made returned an object of type tuple; it must return a predictor"),
        (do_mpc_controller, MHE, "must return an MPC of do-mpc"),
        (do_mpc_estimator, MPC, "must return an MHE of do-mpc"),
    ],
)
def test_another_object_is_refused(decorator, made, message):
    """In every run, so that `check` reports it."""

    def function(x0, P0):
        return made

    function.__name__ = "made"
    given = {"x0": np.zeros(1), "P0": np.eye(1), "model": None, "Ts": 1.0, "rng": np.random.default_rng(0)}
    kind = decorator(function)
    names = kind.__init__.__signature__.parameters
    with pytest.raises(TypeError, match=message):
        kind(**{name: value for name, value in given.items() if name in names})


def filter_of(model, x0, P0):
    """Return a new Kalman filter."""
    return filters.linear(KalmanFilter, model, x0, P0)


MADE = {}
"""Objects that are made once."""


@filterpy_estimator
def once(model, x0, P0):
    """The same filter for every run."""
    return MADE.setdefault("filter", filter_of(model, x0, P0))


@filterpy_estimator
def shared_bank(model, x0, P0):
    """A new bank of filters that are the same for every run."""
    every = MADE.setdefault("bank", [filter_of(model, x0, P0) for _ in range(2)])
    return IMMEstimator(every, [0.5, 0.5], np.full((2, 2), 0.5))


@do_mpc_controller
def one_mpc(model):
    """The same MPC for every run."""
    return MADE.setdefault("mpc", tracking(model, 3, 1.0, 1.0))


@pytest.mark.parametrize(
    ("group", "marked"), [("estimators", once), ("estimators", shared_bank), ("controllers", one_mpc)]
)
def test_the_same_object_for_every_run_is_refused(group, marked):
    """In all runs alike, the first one and those of a later block included: x_hat was that of the run before."""
    MADE.clear()
    part = designed(group, marked)
    status, _, _, journals = simulated(experiment(**{group.removesuffix("s"): part}, n_runs=3), 2)
    assert set(status) == {Status.CRASHED}
    messages = {each.message for journal in journals for each in journal.failures.values()}
    assert messages == {
        f"TypeError: {marked.__name__} returns the same object for every run; make a new one in the function"
    }


def test_a_second_call_draws_no_random_numbers_of_the_run():
    """The function is called twice at first, the first time with a copy of the generator."""
    drawn = []

    @filterpy_estimator
    def random(model, x0, P0, rng):
        drawn.append((rng.standard_normal(), np.random.standard_normal()))  # noqa: NPY002
        return filter_of(model, x0, P0)

    given = {"model": MODEL, **START}
    for _ in range(2):
        random(**given, rng=np.random.default_rng(3))
    assert len(drawn) == 3 and len({*drawn}) == 1
