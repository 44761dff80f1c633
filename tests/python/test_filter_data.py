"""An estimator on recorded arrays: the numbers of the plant `data` and of a filter by hand, and wrong calls."""

import inspect
import warnings

import numpy as np
import pytest
from recorded_runs import write_run
from required_keys import REQUIRED

import rmpc_bench
from rmpc_bench import LinearModel, filter_data, load_config, registry, run, single_run
from rmpc_bench.types import DesignError, InvalidReturnValue

A, B, C = np.array([[0.9, 0.2], [0.0, 0.7]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
MODEL = LinearModel(A, B, C, 0.01, 0.04)
START = {"x0": [0.5, 0.0], "P0": 0.2}
KEYS = REQUIRED | {
    "directional-kalman": {"q": 0.01, "direction": [[1.0], [0.0]]},
    "gated-kalman": {"gate": 50.0},
    "moving-horizon": {"window": 3},
}
KINDS = [kind for kind in registry.BUILT_IN["estimators"] if kind != "oracle"]
RUNS, SAMPLES = 3, 26


@pytest.fixture(scope="module")
def recorded():
    """Return y and u of some runs; the second one has gaps."""
    rng = np.random.default_rng(4)
    x, y, u = np.zeros((RUNS, 2)), np.empty((RUNS, SAMPLES, 1)), rng.standard_normal((RUNS, SAMPLES, 1))
    for k in range(SAMPLES):
        y[:, k] = x @ C.T + 0.2 * rng.standard_normal((RUNS, 1))
        x = x @ A.T + u[:, k] @ B.T + 0.1 * rng.standard_normal((RUNS, 2))
    y[1, [4, 5, 11]] = np.nan
    return y, u


@pytest.fixture(scope="module")
def of_plant(recorded, tmp_path_factory):
    """Return the recorded estimates of an experiment with the plant `data` and every kind as a method."""
    place = tmp_path_factory.mktemp("recorded")
    for i, (y, u) in enumerate(zip(*recorded, strict=True)):
        write_run(place / f"run-{i}.csv", u, y, np.zeros((SAMPLES, 2)))
    config = {
        "version": 1,
        "name": "recorded",
        "runs": RUNS,
        "time": {"step": 0.1, "steps": SAMPLES - 1},
        "plant": {
            "data": f"{place}/run-*.csv",
            "columns": {"y": "level", "u": "voltage", "x": ["x1", "x2"]},
            "t": "time",
        },
        "model": {"kind": "linear", "A": A, "B": B, "C": C, "P_w": 0.01, "P_v": 0.04},
        "initial": {"x_hat": START["x0"], "P": START["P0"]},
        "methods": {kind: {"estimator": {"kind": kind, **KEYS.get(kind, {})}} for kind in KINDS},
        "metrics": ["estimation_mse"],
        "record": {"runs": "all", "signals": ["x_hat", "P", "e", "S"]},
        "figures": [],
    }
    return run(load_config(config), directory=place / "out", jobs=1).stored.traces


def made(kind):
    """The estimator of a kind for data of any length, with what else its design takes of the start."""
    taken = inspect.signature(registry.get("estimators", kind)).parameters
    given = {**START, "Ts": 0.1, "M0": None if taken.get("M0") and taken["M0"].default is None else 0.0}
    return rmpc_bench.estimator(kind, MODEL, **{k: v for k, v in given.items() if k in taken}, **KEYS.get(kind, {}))


@pytest.mark.parametrize("kind", KINDS)
def test_the_numbers_are_those_of_the_plant_data(kind, recorded, of_plant):
    estimator, signals = made(kind), of_plant[kind].signals
    found = filter_data(estimator, *recorded)
    assert np.isfinite(found.x_hat[0]).all() and not np.array_equal(found.x_hat[0], found.x_hat[2])
    for name in ("x_hat", "P", "e", "S"):
        values = getattr(found, name)
        if name in signals and values is not None:
            np.testing.assert_array_equal(values.reshape(RUNS, SAMPLES, -1), signals[name])
        else:
            assert name not in estimator.sized(2).reports and np.isnan(signals.get(name, np.nan)).all()


@pytest.mark.parametrize("missing", [[], [3, 4, 20]])
def test_it_is_the_kalman_filter_written_by_hand(missing, rng):
    y, u = rng.standard_normal((50, 1)), rng.standard_normal((49, 1))
    y[missing] = np.nan
    x, P, R, one = np.array([0.5, 0.0]), 0.2 * np.eye(2), np.array([[0.04]]), np.eye(2)
    expected = []
    for k in range(50):
        S, e = C @ P @ C.T + R, y[k] - C @ x
        if not np.isnan(e[0]):
            K = P @ C.T / S
            x, P = x + K @ e, (one - K @ C) @ P @ (one - K @ C).T + K @ R @ K.T
        expected.append((x, P, e, S, e @ np.linalg.solve(S, e)))
        if k < 49:
            x, P = A @ x + B @ u[k], A @ P @ A.T + 0.01 * one
    found = filter_data(made("kalman"), y, u)
    for values, by_hand in zip(found, map(np.array, zip(*expected, strict=True)), strict=True):
        largest = np.nanmax(np.abs(by_hand))
        # Two roundings of the largest number: the filter keeps roots of P.  The nis is a square of small numbers.
        scale = 4.5e-16 if values.ndim > 1 else 4.5e-15
        np.testing.assert_allclose(values, by_hand, rtol=0, atol=scale * max(largest, 1.0))
    frame = found.to_frame()
    assert [*frame] == ["k", "x_hat.0", "x_hat.1", *(f"P.{i}" for i in range(4)), "e", "S", "nis"]
    assert np.isnan(frame["nis"]).sum() == len(missing)


def test_of_several_runs_each_is_that_of_a_run_alone(recorded):
    y, u = recorded
    found = filter_data(made("kalman"), y, u)
    for i in range(RUNS):
        for values, alone in zip(found, filter_data(made("kalman"), y[i], u[i]), strict=True):
            np.testing.assert_array_equal(values[i], alone)
    assert found.to_frame()["run"].tolist() == sorted([0, 1, 2] * SAMPLES)


@single_run
class Own:
    """Observer of one run, which may fail."""

    def __init__(self, model, fails: str = ""):
        self.model, self.fails = model, fails

    def start(self, x0):
        self.x_pred = x0

    def update(self, y, u_previous, k):
        if k == 2 and self.fails == "raise":
            raise ZeroDivisionError("at the third sample")
        if self.fails == "warn":
            warnings.warn("out of the usual range", stacklevel=1)
        if self.fails == "shape":
            return [0.0]
        self.x_pred = self.x_pred if u_previous is None else A @ self.x_pred + B @ u_previous
        self.x_pred = self.x_pred + 0.5 * C[0] * (y - C @ self.x_pred)
        return self.x_pred


@pytest.fixture
def own():
    rmpc_bench.register("estimator", "own-observer", Own)
    return lambda **keys: rmpc_bench.estimator("own-observer", MODEL, Ts=0.1, **START, **keys)


def test_an_estimator_of_the_user(own, recorded):
    y, u = recorded[0][0], recorded[1][0]
    found = filter_data(own(), y, u)
    x = np.array(START["x0"])
    for k in range(SAMPLES):
        x = x if k == 0 else A @ x + B @ u[k - 1]
        x = x + 0.5 * C[0] * (y[k] - C @ x)
        np.testing.assert_array_equal(found.x_hat[k], x)
    assert found.P is found.e is found.S is found.nis is None
    with pytest.raises(ZeroDivisionError, match="at the third sample") as caught:
        filter_data(own(fails="raise"), y, u)
    assert caught.traceback[-1].name == "update"
    with pytest.raises(InvalidReturnValue, match="run 0: update returned 1 number; the model has 2 states"):
        filter_data(own(fails="shape"), y, u)
    with pytest.warns(RuntimeWarning, match=r"out of the usual range .*\(26 times\)"):
        filter_data(own(fails="warn"), y, u)


@pytest.mark.parametrize(
    ("y", "u", "message"),
    [
        (np.zeros(5), np.zeros((5, 1)), r"y has shape \(5,\); \(samples, ny\) fits"),
        (np.zeros((5, 1)), np.zeros(5), r"u has shape \(5,\); \(samples, nu\) fits"),
        (np.zeros((5, 1)), np.zeros((3, 1)), r"u has shape \(3, 1\), and y \(5, 1\)"),
        (np.zeros((2, 5, 1)), np.zeros((3, 5, 1)), r"u has shape \(3, 5, 1\), and y"),
        (np.zeros((5, 1)), np.full((5, 1), np.nan), "u must be finite"),
        (np.full((5, 1), np.inf), np.zeros((5, 1)), "y must not be infinite"),
        (np.zeros((5, 2)), np.zeros((5, 1)), "y has 2 columns; 1, one per output of the model, fits"),
        (np.zeros((5, 1)), None, "u is missing; 1, one per input of the model, fits"),
        (np.zeros((5, 1)), np.zeros((5, 2)), "u has 2 columns; 1, one per input of the model, fits"),
        (np.zeros((5, 1)) * 1j, None, "y must be real numbers"),
        (np.zeros((5, 1), dtype="datetime64[s]"), None, "y must be real numbers"),
        ([["a"]], None, "y must be real numbers"),
        ({"y": 1.0}, None, "y must be real numbers"),
        (np.zeros((5, 1)), "abc", "u must be real numbers"),
        (np.zeros((0, 1)), None, r"y has shape \(0, 1\)"),
    ],
)
def test_wrong_data_are_refused(y, u, message):
    with pytest.raises(DesignError, match=message):
        filter_data(made("kalman"), y, u)


@pytest.mark.parametrize("kind", KINDS)
def test_no_estimator_takes_a_missing_input_for_zero(kind):
    """Where the model has an input, also of estimators that do not show its matrix."""
    with pytest.raises(DesignError, match="u is missing"):
        filter_data(made(kind), np.zeros((5, 1)), None)


@pytest.mark.parametrize("kind", ["unscented-kalman", "huber-kalman", "kalman-disturbance"])
def test_without_an_input_none_is_enough(kind):
    model = rmpc_bench.LinearModel(A, np.zeros((2, 1)), C, 1e-4, 1e-2)
    estimator = rmpc_bench.estimator(kind, model, **START)
    found = [filter_data(estimator, np.ones((5, 1)), u).x_hat for u in (None, np.zeros((5, 1)))]
    np.testing.assert_array_equal(*found)


def test_masked_samples_are_missing(recorded):
    y, u = (each[0].copy() for each in recorded)
    masked = np.ma.masked_array(y, mask=np.arange(len(y))[:, None] % 5 == 2)
    y[masked.mask] = np.nan
    np.testing.assert_array_equal(filter_data(made("kalman"), masked, u).x_hat, filter_data(made("kalman"), y, u).x_hat)


def test_an_estimator_without_methods_is_refused():
    class Half(rmpc_bench.Estimator):
        def init(self, n_runs):
            return n_runs

    with pytest.raises(DesignError, match="Half does not define correct, predict"):
        filter_data(Half(), np.zeros((5, 1)), None)


def test_without_n_steps_there_is_no_start_and_other_mistakes_are_reported_at_once():
    with pytest.raises(DesignError, match="'n_steps' is missing"):
        made("kalman").init(1)
    with pytest.raises(DesignError, match="P0"):
        rmpc_bench.estimator("kalman", MODEL, x0=0, P0=-1)
    with pytest.raises(DesignError, match="'x0' is missing"):
        rmpc_bench.estimator("kalman", MODEL, P0=1)
