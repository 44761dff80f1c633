"""Late and rarely measured outputs in the loop, from the YAML: stationary values, limits, blocks, and mistakes."""

import numpy as np
import pytest
import yaml
from conftest import within_stat
from scipy.linalg import solve_discrete_are
from small_experiment import ran

from rmpc_bench import load_config
from rmpc_bench.estimators import kalman
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.simulation.closed_loop import simulate, simulate_block
from rmpc_bench.simulation.episode import Episode
from rmpc_bench.simulation.late_measurements import Arrivals
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.types import Estimate, Estimator, InvalidReturnValue, Journal, KnownDelay, Status

A, B, C = np.array([[1.0, 0.1], [0.0, 0.98]]), np.array([[0.005], [0.1]]), np.array([[1.0, 0.0]])
P_W, P_V = np.diag([1e-5, 1e-3]), np.array([[4e-3]])
PREDICTED = solve_discrete_are(A.T, C.T, P_W, P_V)
CORRECTED = PREDICTED - PREDICTED @ C.T @ np.linalg.inv(C @ PREDICTED @ C.T + P_V) @ C @ PREDICTED
STEPS = 700
ON_TIME = "same"
LATE = "{sum: [same, {delayed: 2}]}"


def text(measurement=ON_TIME, delay=None, of_input=0, **keys):
    """Return the configuration of the system of the specification with laws of the measurement and of the input."""
    model = {"from": "plant", "P_w": [1e-5, 1e-3], "P_v": 4e-3} | ({} if delay is None else {"delay": delay})
    tree = {
        "version": 1, "name": "late", "runs": 4, "seed": 3, "time": {"steps": STEPS},
        "plant": {"kind": "linear", "A": A.tolist(), "B": B.tolist(), "C": C.tolist()}, "model": model,
        "noise": {"process": "same", "measurement": yaml.safe_load(measurement)}
        | ({"input": {"delayed": of_input}} if of_input else {}),
        "initial": {"P": PREDICTED.tolist()}, "reference": {"kind": "constant", "value": 0},
        "controller": {"kind": "control-lqr", "Q_x": [1, 0.1], "R_u": 0.1},
        "methods": {"KF": {"estimator": {"kind": "kalman"}}}, "metrics": ["estimation_mse", "mse", "nis"],
        "figures": [],
    }  # fmt: skip
    return yaml.safe_dump({name: value for name, value in (tree | keys).items() if value is not None}, sort_keys=False)


@pytest.fixture
def load(tmp_path):
    """Return a function that loads such a configuration."""

    def loaded(*given, **keys):
        (tmp_path / "late.yaml").write_text(text(*given, **keys))
        return load_config(tmp_path / "late.yaml")

    return loaded


def record(experiment, runs=range(1), draws=None, **options):
    """Trajectories of the only method."""
    draws = experiment.scenario.draw(experiment.plant, runs, experiment.n_steps) if draws is None else draws
    r = np.zeros((experiment.n_steps + 1 + 50, experiment.plant.ny))
    found, status = simulate(experiment.plant, experiment.methods[0], draws, r, experiment.n_steps, **options)
    assert not status.any()
    return found


ROWS = [
    (ON_TIME, None, 0, 0.005612613, 0.036877631, 0.003402079),
    (LATE, "same", 0, 0.008421933, 0.044221661, 0.004585664),
    (LATE, "none", 0, 0.009096706, 0.052726569, 0.005385757),
    (LATE, "same", 1, 0.010112566, 0.048063835, 0.004585664),
]


@pytest.mark.parametrize(("law", "delay", "of_input", "x1", "u", "error"), ROWS)
def test_stationary_values_of_the_loop(load, law, delay, of_input, x1, u, error):
    """Oracle: a Lyapunov equation of the whole loop, to nine digits; one impulse per run, whose squares add up."""
    experiment = load(law, delay, of_input).experiment
    draws = experiment.scenario.draw(experiment.plant, range(3), STEPS)
    w, v = np.zeros_like(draws.w), np.zeros_like(draws.v)
    w[0, 100, 0], w[1, 100, 1], v[2, 100, 0] = np.sqrt([1e-5, 1e-3, 4e-3])
    found = record(experiment, draws=draws._replace(w=w, v=v, x0=0.0 * draws.x0))
    np.testing.assert_allclose((found.x[:, :, 0] ** 2).sum(), x1, rtol=2e-7)
    np.testing.assert_allclose((found.u**2).sum(), u, rtol=2e-7)
    np.testing.assert_allclose(((found.x_hat - found.x) ** 2).sum() / 2, error, rtol=2e-7)


@pytest.mark.parametrize(("law", "delay", "of_input", "x1", "u", "error"), ROWS[1:])
def test_the_same_values_by_simulation(load, law, delay, of_input, x1, u, error):
    """Oracle: the same numbers, within 5 standard errors over runs, and nis = 1 where the delay is known."""
    experiment = load(law, delay, of_input, time={"steps": 300}).experiment
    found = record(experiment, range(80), info=("e", "S"))
    x, x_hat, u_found = found.x[:, 60:], found.x_hat[:, 60:], found.u[:, 60:]
    assert within_stat((x[:, :, 0] ** 2).mean(axis=1), x1)
    assert within_stat((u_found**2).mean(axis=(1, 2)), u)
    assert within_stat(((x_hat - x) ** 2).mean(axis=(1, 2)), error)
    if delay == "same":
        assert within_stat((found.info["e"] ** 2 / found.info["S"])[:, 2:, 0].mean(axis=1), 1.0)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_known_constant_delays(load, d):
    """Oracle: the filter of the model with the last d outputs as further states; P = A^d P_f A'^d + sum."""
    experiment = load(f"{{sum: [same, {{delayed: {d}}}]}}", "same", time={"steps": 120}).experiment
    draws = experiment.scenario.draw(experiment.plant, range(3), 120)
    found = record(experiment, draws=draws, with_P=True)
    P = CORRECTED
    for _ in range(d):
        P = A @ P @ A.T + P_W
    np.testing.assert_allclose(found.P[:, -1], np.broadcast_to(P, (3, 2, 2)), rtol=1e-9)  # another recursion
    F, G, H = np.zeros((2 + d, 2 + d)), np.zeros((2 + d, 1)), np.zeros((1, 2 + d))
    F[:2, :2], F[2, :2], G[:2], H[0, -1] = A, C[0], B, 1.0
    F[3:, 2:-1] = np.eye(d - 1)
    Q, P0 = np.zeros((2, *F.shape))
    Q[:2, :2], P0[:2, :2] = P_W, PREDICTED
    whole = kalman.design(LinearModel(F, G, H, Q, P_V), 120, x0=np.zeros(2 + d), P0=P0)
    state, y = whole.init(3), found.y + draws.v
    for k in range(121):
        arrived = y[:, k - d] if k >= d else np.full((3, 1), np.nan)
        state, estimate = whole.correct(k, state, arrived)
        np.testing.assert_allclose(found.x_hat[:, k], estimate.x_hat[:, :2], rtol=1e-9, atol=1e-12)
        state = whole.predict(k, state, found.u[:, min(k, 119)])


def test_a_slow_sensor_has_an_error_in_every_phase(load):
    """Oracle: the periodic Riccati equation of the specification; the reported P is that error."""
    experiment = load("{sum: [same, {missing: {every: 4}}]}", time={"steps": 400}).experiment
    P = record(experiment, with_P=True).P[0]
    found = [np.trace(P[k]) / 2 for k in (396, 397, 398, 399)]
    np.testing.assert_allclose(found, [0.004524084, 0.005147909, 0.005823127, 0.006556086], rtol=2e-7)  # nine digits


@pytest.mark.parametrize("delay", ["same", "none", {"measurement": 0}])
def test_a_delay_of_0_is_none(load, delay):
    """Oracle: the experiment without the law, bit for bit, also where that has a compiled loop."""
    plain, late = load(time={"steps": 60}), load("{sum: [same, {delayed: 0}]}", delay, time={"steps": 60})
    one, other = (simulate_block(each.experiment, each.experiment.methods[0], range(4)) for each in (plain, late))
    np.testing.assert_array_equal(one.metrics, other.metrics)
    one, other = (record(each.experiment, range(4), with_P=True) for each in (plain, late))
    for name in ("x", "u", "x_hat", "P"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


RANDOM = "{sum: [same, {delayed: {samples: [0, 3]}}, {missing: {probability: 0.2}}]}"


@pytest.mark.parametrize("delay", ["same", "none", {"measurement": 2}])
def test_a_row_of_a_block_is_a_run_alone(load, delay):
    """Oracle: blocks of one run, bit for bit."""
    experiment = load(RANDOM, delay, time={"steps": 40}).experiment
    whole = simulate_block(experiment, experiment.methods[0], range(4))
    assert not whole.status.any()
    for run in range(4):
        alone = simulate_block(experiment, experiment.methods[0], range(run, run + 1))
        np.testing.assert_array_equal(alone.metrics[:, 0], whole.metrics[:, run])


def test_trials_do_not_depend_on_workers(tmp_path):
    """Oracle: trials.csv of one worker, byte for byte."""
    (tmp_path / "late.yaml").write_text(text(RANDOM, "same", time={"steps": 30}))
    one = ran(tmp_path / "late.yaml", tmp_path / "one")
    assert ran(tmp_path / "late.yaml", tmp_path / "two", "-s", "execution.block=1", jobs=2) == one


def arrivals(d, y, known):
    """What arrives over k for one run and output: the newest value, and what the filter gets by age."""
    from estimators.test_late_measurements import drawn

    found = Arrivals(drawn(np.array(d)[None, :, None]), known)
    both = [found.at(k, np.array([[value]])) for k, value in enumerate(y)]
    return [now[0, 0] for now, _ in both], [np.array(each)[..., 0, 0] if found.D else each[0, 0] for _, each in both]


def test_the_newest_value_that_arrives_counts():
    """Oracle: by hand; at k = 2 the samples 1 and 2 arrive, at k = 3 only sample 0, which is older."""
    d, y = [2, 1, 0, 0, 2], [1.0, 2.0, 3.0, 4.0, 5.0]
    now, given = arrivals(d, y, KnownDelay(0, (0,)))
    np.testing.assert_array_equal(now, [np.nan, np.nan, 3.0, 4.0, np.nan])
    np.testing.assert_array_equal(given, now)
    now, given = arrivals([2, 2, 0, 0, 1], y, KnownDelay(0, None))
    np.testing.assert_array_equal(now, [np.nan, np.nan, 3.0, 4.0, np.nan])
    np.testing.assert_array_equal(given[2], [3.0, np.nan, 1.0])
    np.testing.assert_array_equal(given[3], [4.0, np.nan, 2.0])
    _, given = arrivals(d, y, KnownDelay(0, (1,)))
    np.testing.assert_array_equal(given[3], [np.nan, 4.0])


def test_a_number_that_is_the_delay_is_same(load):
    """Oracle: `same`, bit for bit; another number is another filter, also without any delay of the plant."""
    short = {"time": {"steps": 60}}
    numbers = ("same", {"measurement": 2}, {"measurement": 1})
    same, two, one = (record(load(LATE, each, **short).experiment) for each in numbers)
    np.testing.assert_array_equal(same.x_hat, two.x_hat)
    assert (same.x_hat != one.x_hat).any()
    plain = load(**short).experiment
    for delay in ({"measurement": 1}, {"measurement": {"y.0": 1}}):
        experiment = load(delay=delay, **short).experiment
        assert (record(experiment).x_hat != record(plain).x_hat).any()
        one, other = (simulate_block(each, each.methods[0], range(2)).metrics for each in (experiment, plain))
        assert (one != other).all()


def test_outputs_with_delays_of_their_own(load):
    """Oracle: nis = 1 over runs, with e and S of different samples in one vector; P is the error."""
    plant = {"kind": "linear", "A": A.tolist(), "B": B.tolist(), "C": [[1, 0], [0, 1]]}
    law = "{sum: [same, {delayed: {samples: 3, only: [y.0]}}, {delayed: {samples: [0, 1], only: [1]}}]}"
    keys = {"plant": plant, "model": {"from": "plant", "P_w": [1e-5, 1e-3], "P_v": [4e-3, 1e-2]}, "runs": 2}
    experiment = load(law, **keys, time={"steps": 150}).experiment
    found = record(experiment, range(100), info=("e", "S"), with_P=True)
    e, S = found.info["e"], found.info["S"].reshape(100, -1, 2, 2)
    assert np.isnan(e[:, :3, 0]).all() and np.isnan(e[:, :, 1]).any()
    squares = np.einsum("rki,rki->rk", e, np.linalg.solve(S, e[..., None])[..., 0]) / 2
    assert within_stat(np.nanmean(squares, axis=1), 1.0)
    error = found.x_hat - found.x
    nees = np.einsum("rki,rki->rk", error, np.linalg.solve(found.P, error[..., None])[..., 0]) / 2
    assert within_stat(nees.mean(axis=1), 1.0)


class Checked(Estimator):
    """A predictor of the user that counts its calls and returns a wrong shape once."""

    bridges_missing = True

    def init(self, n_runs):
        return np.zeros((n_runs, 2))

    def correct(self, k, state, y):
        if k == 4:
            return state, Estimate(np.zeros(3))
        return state, Estimate(state)

    def predict(self, k, state, u):
        u[:] = np.nan  # a component may use its arguments
        return state @ A.T


def test_answers_of_a_class_of_the_user_are_checked(load):
    """Oracle: the message of the loop without delays."""
    experiment = load(LATE, "same", time={"steps": 10}).experiment
    [method] = experiment.methods
    own = method._replace(estimator=Checked())
    draws = experiment.scenario.draw(experiment.plant, range(2), 10)
    with pytest.raises(InvalidReturnValue, match="x_hat"):
        simulate(experiment.plant, own, draws, np.zeros((60, 1)), 10)


class Copied(Checked):
    """A predictor with a warning when a state is copied."""

    def correct(self, k, state, y):
        return state, Estimate(state)

    def copied(self, state):
        np.log(np.zeros(1))
        return state.copy()


def test_warnings_of_a_copy_are_those_of_the_user(load):
    """They are counted, as those of `correct` and `predict` are."""
    experiment = load(LATE, "same", time={"steps": 10}).experiment
    own, start = experiment.methods[0]._replace(estimator=Copied()), RunStart(0, (0, 1), Journal())
    draws = experiment.scenario.draw(experiment.plant, range(2), 10)
    simulate(experiment.plant, own, draws, np.zeros((60, 1)), 10, start=start)
    assert [text.partition(" (")[0] for text in start.journal.warnings] == [
        "RuntimeWarning: divide by zero encountered in log"
    ]


def test_a_failed_run_leaves_the_others(load):
    """Oracle: the other runs without it, bit for bit."""
    experiment = load(RANDOM, "same", time={"steps": 40}).experiment
    draws = experiment.scenario.draw(experiment.plant, range(4), 40)
    broken = draws._replace(v=draws.v.copy())
    broken.v[1, 7] = np.inf
    r = np.zeros((100, 1))
    one, status = simulate(experiment.plant, experiment.methods[0], broken, r, 40, with_P=True)
    other = record(experiment, draws=draws, with_P=True)
    assert [bool(each) for each in status] == [False, True, False, False]
    for name in ("x", "u", "x_hat", "P"):
        np.testing.assert_array_equal(getattr(one, name)[[0, 2, 3]], getattr(other, name)[[0, 2, 3]])


OWN = """
import threading
import numpy as np
from rmpc_bench import single_run

@single_run
class Filter:
    bridges_missing = True
    def __init__(self, model, x0, P0):
        self.model, self.x, self.P = model, x0, P0
    def update(self, k, y, u_previous):
        now = self.model.at(0)
        if k > 0:
            self.x, self.P = now.A @ self.x + now.B @ u_previous, now.A @ self.P @ now.A.T + now.Q_w
        if not np.isnan(y[0]):
            L = self.P @ now.C.T @ np.linalg.inv(now.C @ self.P @ now.C.T + now.R_v)
            self.x, self.P = self.x + L @ (y - now.C @ self.x), self.P - L @ now.C @ self.P
        return self.x, self.P

@single_run
class Locked(Filter):
    def __init__(self, model, x0, P0):
        super().__init__(model, x0, P0)
        self.lock = threading.Lock()
"""


def test_objects_of_single_runs_are_copied(load, tmp_path):
    """Oracle: `kalman`; an object that cannot be copied fails its run, with the reason."""
    (tmp_path / "own.py").write_text(OWN)
    methods = {"KF": {"estimator": {"kind": "kalman"}}, "own": {"estimator": {"file": "own.py:Filter"}}}
    methods["locked"] = {"estimator": {"file": "own.py:Locked"}}
    experiment = load(RANDOM, "same", methods=methods, metrics=["estimation_mse", "mse"], time={"steps": 40}).experiment
    blocks = {name: simulate_block(experiment, experiment.method(name), range(3)) for name in methods}
    np.testing.assert_allclose(blocks["own"].metrics, blocks["KF"].metrics, rtol=1e-9)  # another recursion
    assert [Status(each).word for each in blocks["locked"].status] == ["crashed"] * 3
    failures = blocks["locked"].journal.failures
    assert "late measurements need a copy of the object: TypeError" in failures[0].message


@pytest.mark.parametrize("delay", ["same", "none"])
def test_an_episode_is_the_run(load, delay):
    """Oracle: the estimates of the loop, bit for bit, with its inputs; y is what arrives."""
    experiment = load(RANDOM, delay, time={"steps": 30}).experiment
    [method], found = experiment.methods, record(experiment, range(2, 3))
    episode = Episode(experiment, 2, method)
    samples = [episode.sample, *(episode.step(u) for u in found.u[0])]
    np.testing.assert_array_equal([each.x_hat for each in samples], found.x_hat[0])
    assert np.isnan([each.y[0] for each in samples]).sum() > 3
