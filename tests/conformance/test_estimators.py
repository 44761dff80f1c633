"""Every registered estimator on three small models: the rules of the base class, bit for bit."""

import pickle

import numpy as np
import pytest
from conftest import random_model, random_psd

from rmpc_bench import registry
from rmpc_bench.estimators.enhanced_robust import Margins
from rmpc_bench.estimators.lmmse import EntryLaw
from rmpc_bench.estimators.risk_sensitive import Radius
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.plants.uncertain_linear import design as uncertain_plant
from rmpc_bench.plants.uncertainty import Uncertainty
from rmpc_bench.types import Estimator, Status

KINDS = registry.names("estimators")
PARAMETERS = {
    "oracle": [{}],
    "kalman": [{}, {"noise": "matched", "use_y0": False}],
    "robust-kalman": [{"c": 0.1}, {"c": 0.1, "kl": "half", "tau": 0.5}],
    "risk-sensitive": [{"theta": 0.01}, {"theta_from": Radius(c=0.01)}, {"theta": 0.01, "tau": 1.0}],
    "kalman-predictor": [{}, {"R": 2.0, "gain": "steady"}],
    "enhanced-robust": [{}, {"eps": Margins(x=0.1, w=0.2, v=0.3), "tuned": True}, {"rule": "state"}],
    "sayed-bdu": [{}, {"alpha": 0.1, "form": "predictor"}],
    "lmmse": [{}, {"law": EntryLaw(mean=0.2, variance=0.1)}],
    "lp-window": [{}, {"Ne": 2, "start": "anchored"}],
    "mixed": [{}, {"q": "lag", "use_y0": False}, {"q": "one-pass"}],
    "set-membership": [
        {},
        {"inflate": False},
        {"update": "maksarov-norton", "level": 0.9999},
        {"update": "maksarov-norton", "level": 0.9999, "criterion": "volume", "use_y0": False},
    ],
    "kalman-disturbance": [{}, {"drift": 0.1, "D0": 2.0, "noise": "matched"}],
}
"""Parameters beyond the start that make a design of each kind; a new kind gets a line here."""
BOUNDED = ("kalman", "mixed", "set-membership", "kalman-disturbance")
"""Kinds that know bounded noises."""
WITHOUT_COVARIANCE = ("lp-window",)
"""Kinds that begin with x0 alone, and bridge a missing measurement by their prediction."""
SIZES = [(1, 1, 1), (3, 2, 2), (4, 1, 2)]
CASES = [(kind, parameters, size) for kind in KINDS for parameters in PARAMETERS.get(kind, []) for size in SIZES]
RUNS, STEPS = 9, 12


def test_every_registered_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


def uncertain(rng, model):
    """Make everything uncertain; model and plant."""
    nx, ny = model.nx, model.ny
    sizes = {"H_A": (nx, 2), "H_C": (ny, 2), "G_x": (2, nx), "H_Bw": (nx, 1), "G_w": (2, nx), "H_Dv": (ny, 2),
             "G_v": (1, ny), "Bv": (nx, ny), "Dw": (ny, nx)}  # fmt: skip
    given = {name: 0.3 * rng.standard_normal((1, *shape)) for name, shape in sizes.items()}
    given |= {"A": model.A[None], "B": model.B[None], "C": model.C[None], "Bw": np.eye(nx), "Dv": np.eye(ny)}
    truth = uncertain_plant(0.1, STEPS, **given)
    return uncertain_model(STEPS, **given, W=model.Q_w.tolist(), V=model.R_v.tolist()), {"plant": truth}


def bounded(rng, model):
    """Give a model bounded noises, the process noise another one at every k."""
    M_w = np.array([(1.0 + 0.5 * np.sin(k)) * random_psd(rng, model.nx) for k in range(STEPS + 1)])
    given = {"A": model.A, "B": model.B, "C": model.C, "P_w": model.Q_w, "P_v": model.R_v}
    return mixed_model(STEPS, **given, M_w=M_w, M_v=30.0 * model.R_v, w_mean=0.3, v_mean=-0.1)


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}-{'-'.join(case[1])}-{case[2][0]}{case[2][1]}{case[2][2]}")
def case(request):
    """Return a design with measurements (runs, samples, ny) and inputs (runs, samples, nu)."""
    kind, parameters, (nx, nu, ny) = request.param
    rng = np.random.default_rng(11)
    model = random_model(rng, nx, nu, ny, 0.9)
    if kind == "oracle":
        model, parameters = uncertain(rng, model)
    start = {"x0": rng.standard_normal(nx)} | ({} if kind in WITHOUT_COVARIANCE else {"P0": model.Q_w})
    if kind in BOUNDED and (kind != "kalman" or parameters):
        model, parameters = bounded(rng, model), parameters | {"M0": 40.0 * model.Q_w}
    design = registry.get("estimators", kind)(model, STEPS, **start, **parameters)
    return design, rng.standard_normal((RUNS, STEPS + 1, ny)), rng.standard_normal((RUNS, STEPS + 1, nu)), model


def start(estimator, rows):
    """State of some runs before the first measurement; an oracle estimator gets their uncertain matrices."""
    if not estimator.knows_uncertainty:
        return estimator.init(len(rows))
    shapes = [tuple(estimator.system.size(f"{axis}{channel}") for axis in "rs") for channel in "xwv"]
    rngs = [np.random.default_rng((9, int(row))) for row in rows]
    return estimator.init(len(rows), Uncertainty().draw(rngs, STEPS + 1, shapes))


def run(estimator, y, u, rows=None):
    """States and estimates of a block, over time."""
    state, states, estimates = start(estimator, range(len(y)) if rows is None else rows), [], []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, np.ascontiguousarray(y[:, k]))
        estimates.append(estimate)
        states.append(state)
        state = estimator.predict(k, state, np.ascontiguousarray(u[:, k]))
        states.append(state)
    return states, estimates


def x_hats(estimator, y, u, rows=None):
    """Estimates of a block, (runs, samples, nx)."""
    return np.stack([estimate.x_hat for estimate in run(estimator, y, u, rows)[1]], axis=1)


def test_it_is_an_estimator(case):
    """Oracle: the base class; a design is frozen."""
    design = case[0]
    assert isinstance(design, Estimator)
    with pytest.raises(AttributeError):
        design.something_new = 1


def test_shapes_and_statuses(case):
    """Oracle: axis 0 is the run; P and M are shared, per run or None; status is int8."""
    design, y, u, model = case
    states, estimates = run(design, y, u)
    for state in states:
        assert all(len(part) == RUNS for part in state)
    for estimate in estimates:
        assert estimate.x_hat.shape == (RUNS, model.nx) and estimate.x_hat.dtype == np.float64
        for matrix in (estimate.P, estimate.M):
            assert matrix is None or matrix.shape in ((model.nx, model.nx), (RUNS, model.nx, model.nx))
        np.testing.assert_array_equal(estimate.status, np.full(RUNS, Status.OK, dtype=np.int8))
        assert estimate.status.dtype == np.int8
        assert all(len(values) == RUNS for values in estimate.info.values())


def test_arguments_are_left_alone(case):
    """Oracle: copies of the measurement, the input and the state taken before the call."""
    design, y, u, _ = case
    state = start(design, range(RUNS))
    for k in range(3):
        before = [part.copy() for part in (*state, y, u)]
        corrected, _ = design.correct(k, state, y[:, k])
        for part, copy in zip((*state, y, u), before, strict=True):
            np.testing.assert_array_equal(part, copy)
        before = [part.copy() for part in (*corrected, y, u)]
        state = design.predict(k, corrected, u[:, k])
        for part, copy in zip((*corrected, y, u), before, strict=True):
            np.testing.assert_array_equal(part, copy)


def test_the_same_call_twice_gives_the_same_bits(case):
    """Oracle: a step is pure, so an old state can be used again."""
    design, y, u, _ = case
    state = start(design, range(RUNS))
    for k in range(3):
        (a, first), (b, second) = design.correct(k, state, y[:, k]), design.correct(k, state, y[:, k])
        np.testing.assert_array_equal(first.x_hat, second.x_hat)
        for left, right in zip(design.predict(k, a, u[:, k]), design.predict(k, b, u[:, k]), strict=True):
            np.testing.assert_array_equal(left, right)
        state = design.predict(k, a, u[:, k])


def test_a_row_equals_a_batch_of_one(case):
    """Oracle: each run alone, bit for bit."""
    design, y, u, _ = case
    together = x_hats(design, y, u)
    for i in range(RUNS):
        np.testing.assert_array_equal(x_hats(design, y[i : i + 1], u[i : i + 1], [i]), together[i : i + 1])


def test_permuting_runs_permutes_results(case):
    """Oracle: the runs in another order, bit for bit."""
    design, y, u, _ = case
    order = np.random.default_rng(5).permutation(RUNS)
    np.testing.assert_array_equal(x_hats(design, y[order], u[order], order), x_hats(design, y, u)[order])


def test_a_pickle_gives_the_same_bits(case):
    """Oracle: the design before its trip to a worker."""
    design, y, u, _ = case
    np.testing.assert_array_equal(x_hats(pickle.loads(pickle.dumps(design)), y, u), x_hats(design, y, u))


def test_a_missing_measurement_leaves_the_other_runs_alone(case):
    """Oracle: the block without it, bit for bit."""
    design, y, u, _ = case
    broken = y.copy()
    broken[4, 3] = np.nan
    ours, expected = x_hats(design, broken, u), x_hats(design, y, u)
    np.testing.assert_array_equal(np.delete(ours, 4, axis=0), np.delete(expected, 4, axis=0))
    np.testing.assert_array_equal(ours[4, :3], expected[4, :3])
    if type(design).__name__ == "LpWindow":
        assert np.isfinite(ours).all() and (ours[4, 3] != expected[4, 3]).any()
    else:
        assert np.isnan(ours[4, 3:5]).any()  # a predictor's estimate uses it one sample later


def test_series_have_the_time_as_axis_0(case):
    """Oracle: one entry per sample k = 0..N, or a single constant one."""
    series = getattr(case[0], "series", dict)()
    assert all(len(values) in (1, STEPS + 1) for values in series.values())
