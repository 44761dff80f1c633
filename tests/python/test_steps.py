"""Steps of estimators in an own loop: shapes and times that do not fit are refused, for every built-in estimator."""

import numpy as np
import pytest
from conftest import ALL
from required_keys import REQUIRED, sampled

import rmpc_bench
from rmpc_bench import registry
from rmpc_bench.models.uncertain_linear import design as uncertain_model

TYPES_FIRST = pytest.mark.skipif(ALL, reason="the checks of annotations refuse such a call first")
N = 4
KEYS = REQUIRED | {
    "mixed": {"M0": 1.0},
    "set-membership": {"M0": 1.0},
    "moving-horizon": {"window": 3},
}
OTHERS = {
    "sayed-bdu-search": ("sayed-bdu", {"lam": "search"}),
    "intersection": ("set-membership", {"M0": 1.0, "update": "maksarov-norton"}),
}
LINEAR = [kind for kind in registry.BUILT_IN["estimators"] if kind != "oracle"]
OPEN = ("extended-kalman", "nonlinear-moving-horizon", "unscented-kalman")
"""Estimators that have no last sample: they ask the model for every k."""
STEADY = "control-lqe"
"""Estimator whose gain is the same at all k; the model of the others depends on k."""


def made(name, runs=1):
    """Return an estimator of one output, one input and two states, and its state after the first sample."""
    kind, keys = OTHERS.get(name, (name, KEYS.get(name, {})))
    if kind == STEADY:
        pytest.importorskip("control")
    matrices = {"A": [[0.9, 0.1], [0.0, 0.8]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]]}
    if kind == "sayed-bdu":
        model = uncertain_model(N, **matrices, Bw=1.0, Dv=1.0, H_A=[[0.1], [0.0]], G_x=[[1.0, 0.0]], W=0.1, V=0.1)
    else:
        a = 0.9 if kind == STEADY else "0.9 + 0.01*k"
        model = rmpc_bench.model("linear", N, **{**matrices, "A": [[a, 0.1], [0.0, 0.8]]}, P_w=0.1, P_v=0.1)
    start = {"x0": 0.0, "P0": 1.0}
    if kind in ("lp-window", STEADY):
        del start["P0"]
    estimator = rmpc_bench.estimator(kind, model, n_steps=N, **start, **sampled(kind), **keys)
    state, _ = estimator.correct(0, estimator.init(runs), np.zeros((runs, 1)))
    return estimator, state


@TYPES_FIRST
@pytest.mark.parametrize("name", [*LINEAR, *OTHERS])
def test_a_measurement_that_does_not_fit(name):
    """NumPy would repeat the one output or the one run."""
    estimator, state = made(name)
    state = estimator.predict(0, state, np.zeros((1, 1)))
    with pytest.raises(ValueError, match=r"y has 3 values, the model has 1 output \(shape \(1, 3\); \(1, 1\) fits\)"):
        estimator.correct(1, state, np.zeros((1, 3)))
    with pytest.raises(ValueError, match=r"y has 2 rows, the state has 1 run \(shape \(2, 1\); \(1, 1\) fits\)"):
        estimator.correct(1, state, np.zeros((2, 1)))
    for wrong in (np.zeros(1), np.zeros((1, 1, 1)), 0.0):
        with pytest.raises(ValueError, match=r"y must have the axes \(runs, outputs\)"):
            estimator.correct(1, state, wrong)
    estimator.correct(1, state, np.zeros((1, 1)))


@TYPES_FIRST
@pytest.mark.parametrize("name", [*LINEAR, *OTHERS])
def test_an_input_that_does_not_fit(name):
    """The product with B would add three inputs."""
    estimator, state = made(name)
    with pytest.raises(ValueError, match=r"u has 3 values, the model has 1 input \(shape \(1, 3\); \(1, 1\) fits\)"):
        estimator.predict(0, state, np.zeros((1, 3)))
    estimator.predict(0, state, np.zeros((1, 1)))


@pytest.mark.parametrize("name", [*LINEAR, *OTHERS])
@pytest.mark.parametrize("k", [-1, N + 2])
def test_a_time_outside_the_design(name, k):
    """No gain is taken from the end of a schedule."""
    estimator, state = made(name)
    state = estimator.predict(0, state, np.zeros((1, 1)))
    if name == STEADY or name in OPEN and k > 0:
        estimator.correct(k, state, np.zeros((1, 1)))
        return
    with pytest.raises(ValueError, match=rf"k = {k} is outside the design"):
        estimator.correct(k, state, np.zeros((1, 1)))


@TYPES_FIRST
def test_the_oracle_refuses_them_too():
    """It has the matrices of every run."""
    keys = {"A": [[0.9]], "B": [[1.0]], "C": [[1.0]], "Bw": 1.0, "Dv": 1.0, "H_A": [[0.1]], "G_x": [[1.0]]}
    plant = rmpc_bench.plant("uncertain-linear", 0.1, N, **keys)
    model = rmpc_bench.model("uncertain-linear", n_steps=N, **keys, W=0.1, V=0.1)
    estimator = rmpc_bench.estimator("oracle", model, N, plant, x0=0.0, P0=1.0)
    state = estimator.init(1, plant.draw({}, [np.random.default_rng(1)], N))
    with pytest.raises(ValueError, match="y has 3 values, the model has 1 output"):
        estimator.correct(0, state, np.zeros((1, 3)))
    state, _ = estimator.correct(0, state, np.zeros((1, 1)))
    with pytest.raises(ValueError, match="u has 3 values, the model has 1 input"):
        estimator.predict(0, state, np.zeros((1, 3)))
    for k in (-1, N + 2):
        with pytest.raises(ValueError, match=rf"k = {k} is outside the design, which has 0 <= k < {N + 1}"):
            estimator.correct(k, state, np.zeros((1, 1)))
