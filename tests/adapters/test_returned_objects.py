"""What the function under a decorator returns, where it is not an object of the library."""

import pytest

pytest.importorskip("do_mpc")
pytest.importorskip("stonesoup")

from types import SimpleNamespace

import numpy as np

from rmpc_bench.adapters.do_mpc import do_mpc_controller, do_mpc_estimator
from rmpc_bench.adapters.filterpy import filterpy_estimator
from rmpc_bench.adapters.stonesoup import stonesoup_estimator

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
