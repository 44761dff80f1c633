"""A configuration as an environment of Gymnasium: the runs of the experiment, bit for bit."""

import warnings

import numpy as np
import pytest
from conftest import ROUND

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

import rmpc_bench  # noqa: E402
from rmpc_bench.adapters.gymnasium import env  # noqa: E402
from rmpc_bench.types import DesignError  # noqa: E402

CONFIG = """\
version: 1
name: trained
seed: 5
runs: 4
time: {step: 0.1, steps: 25}
uncertainty: {eps: +-40%}
plant:
  ode: tank.py:rhs
  states: {level: m}
  inputs: {inflow: m^3/s}
  parameters: {a: 0.4}
  perturb: {a: 1 + eps}
  bounds: {level: [0.02, 0.62], inflow: [0, 0.6]}
model: {linearise: plant, at: {u: 0.2, guess: 0.3}, noise: {process: 1e-4, measurement: 1e-4}}
noise: {process: {gaussian: {std: 0.01}}, measurement: {gaussian: {std: 0.02}}}
initial: {x: 0.25, x_hat: 0.3, P: 0.01}
reference: {kind: square, values: [0.3, 0.4], period: 1}
methods:
  y: {estimator: {kind: kalman}, controller: {file: tank.py:OfMeasurement, K: 2.5}}
  x_hat: {estimator: {kind: kalman}, controller: {file: tank.py:OfEstimate, K: 2.5}}
metrics: [mse, input_power]
record: {runs: 4, signals: [x, y, u, x_hat]}
"""
TANK = """\
import numpy as np
from rmpc_bench import single_run
def rhs(x, u, p): return [u[0] - p.a * np.sqrt(x[0])]
@single_run
class OfMeasurement:
    def __init__(self, K: float = 1.0): self.K = K
    def control(self, y, r): return [0.2 + self.K * (r[0] - y[0])]
@single_run
class OfEstimate:
    def __init__(self, K: float = 1.0): self.K = K
    def control(self, x_hat, r): return [0.2 + self.K * (r[0] - x_hat[0])]
"""


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    """Return the configuration."""
    directory = tmp_path_factory.mktemp("trained")
    (directory / "tank.py").write_text(TANK)
    (directory / "trained.yaml").write_text(CONFIG)
    return rmpc_bench.load_config(directory / "trained.yaml")


@pytest.fixture(scope="module")
def results(config, tmp_path_factory):
    """Return its trials."""
    return rmpc_bench.run(config, directory=tmp_path_factory.mktemp("stored"), engine="serial").trials


def played(made, run):
    """Apply the law of the configuration to the first entry of the observation, until the run ends."""
    observation, info = made.reset(options={"run": run})
    seen, x, y, u, rewards, ended = [observation], [info["x"]], [info["y_true"]], [], [], False
    while not ended:
        action = np.array([0.2 + 2.5 * (observation[1] - observation[0])])
        observation, reward, terminated, truncated, info = made.step(action)
        # The plant limits it to its bounds, although the environment has wider limits.
        u.append(np.clip(action, 0.0, 0.6))
        np.testing.assert_array_equal(observation[2:], u[-1])
        seen.append(observation)
        x.append(info["x"])
        y.append(info["y_true"])
        rewards.append(reward)
        ended = terminated or truncated
    assert terminated != truncated
    return np.array(seen), np.array(x), np.array(y), np.array(u), np.array(rewards), info


@pytest.mark.parametrize("method", ["y", "x_hat"])
def test_every_run_is_that_of_the_experiment(config, results, method):
    """Oracle: the recorded runs of `run`; the sum of the rewards is the metric."""
    made, n_failed = env(config, None if method == "y" else method, limits=(-10.0, 10.0)), 0
    trace = results.traces[method].signals
    for run in range(4):
        seen, x, y, u, rewards, info = played(made, run)
        failed = results.frame.set_index(["method", "run"]).loc[(method, run), "status"] != "ok"
        n_failed += failed
        assert (info["status"] != "ok") == failed
        if failed:
            assert info["status"] == "out-of-range"
            assert "left its bounds" in info["message"]
            continue
        np.testing.assert_array_equal(x, trace["x"][run])
        np.testing.assert_array_equal(y, trace["y"][run])
        np.testing.assert_array_equal(u, trace["u"][run])
        if method == "x_hat":
            np.testing.assert_array_equal(seen[:, 0], trace["x_hat"][run, :, 0])
        np.testing.assert_allclose(-rewards.mean(), results.column("mse", method)[run], **ROUND)
    assert n_failed < 4


def test_the_disturbance_of_a_design_model_is_observed(config, tmp_path):
    """Oracle: the recorded runs of `run`; the observation is x_hat, d_hat, r and u(k-1), in this order.

    The unit of the disturbance is so small that a state as large as it would fail the run.
    """
    text = (
        "d: {estimator: {kind: kalman}, controller: {file: tank.py:OfEstimate, K: 2.5},"
        " model: {disturbance: {at: {B_d: [[1e-9]]}, drift: 1e13}}}"
    )
    disturbed = rmpc_bench.load_config(config.path, add_methods=[text])
    stored = rmpc_bench.run(disturbed, directory=tmp_path, engine="serial").trials
    made, trace, compared = env(disturbed, "d", limits=(-10.0, 10.0)), stored.traces["d"].signals, 0
    for run in range(4):
        observation, _ = made.reset(options={"run": run})
        assert observation.shape == made.observation_space.shape == (4,)
        if stored.frame.set_index(["method", "run"]).loc[("d", run), "status"] != "ok":
            continue
        steps = [made.step(u) for u in trace["u"][run]]
        assert not any(terminated for _, _, terminated, _, _ in steps)
        seen = [observation, *(each[0] for each in steps)]
        np.testing.assert_array_equal(np.array(seen)[:, 0], trace["x_hat"][run, :, 0])
        np.testing.assert_array_equal(np.array(seen)[1:, 3], trace["u"][run, :, 0])
        assert np.abs(np.array(seen)[:, 1]).max() > 1e6
        compared += 1
    assert compared


def test_it_passes_the_checker_of_gymnasium(config):
    """Only the advice on unlimited spaces is given as a warning."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env(config))
    texts = [str(each.message) for each in caught]
    expected = ("infinity", "symmetric and normalized", "due to the environment not having a spec")
    assert all(any(part in text for part in expected) for text in texts), texts
    made = env(config)
    assert (made.action_space.low, made.action_space.high) == (0.0, 0.6)
    assert made.observation_space.shape == (3,)
    assert env(config, preview=4).observation_space.shape == (6,)


def test_runs_of_training_are_not_those_of_the_experiment(config):
    """A seed gives a sequence of runs beyond the experiment; only the option gives one of its runs."""
    made = env(config)
    runs = [made.reset(seed=0)[1]["run"], *(made.reset()[1]["run"] for _ in range(3))]
    again = [made.reset(seed=0)[1]["run"], *(made.reset()[1]["run"] for _ in range(3))]
    assert runs == again
    assert len({*runs}) == 4
    assert min(runs) >= 4
    info = made.reset(options={"run": 3})[1]
    assert info["in_experiment"]
    assert not made.reset()[1]["in_experiment"]


def test_cost_and_failure(config):
    """Oracle: the cost by hand; a failed run terminates and costs what `failure` says."""
    made = env(config, cost={"Q": 2.0, "R_u": 3.0, "R_du": 5.0, "failure": 100.0})
    observation, info = made.reset(options={"run": 1})
    first = made.step([0.1])
    expected = 2.0 * (info["y_true"][0] - observation[1]) ** 2 + 3.0 * 0.1**2 + 5.0 * 0.1**2
    np.testing.assert_allclose(-first[1], expected, **ROUND)
    y, r, u = first[4]["y_true"][0], first[0][1], 0.6
    second = made.step([7.0])  # limited to 0.6
    np.testing.assert_allclose(-second[1], 2.0 * (y - r) ** 2 + 3.0 * u**2 + 5.0 * (u - 0.1) ** 2, **ROUND)
    assert second[0][2] == 0.6
    while True:
        _, reward, terminated, truncated, info = made.step([0.6])
        if terminated or truncated:
            break
    assert terminated
    assert not truncated
    assert reward < -100.0
    with pytest.raises(RuntimeError, match="the episode is over"):
        made.step([0.6])


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"method": "yy"}, "'yy' is not a known method"),
        ({"cost": {"R": 1.0}}, "'R' is not a known weight"),
        ({"cost": {"Q": [1.0, 2.0]}}, "does not fit"),
        ({"at": {"controller.Hp": "3"}}, "path of the sweep"),
    ],
)
def test_errors(config, keys, text):
    """Every message says what there is."""
    with pytest.raises(DesignError, match=text):
        env(config, **keys)


def test_a_missing_measurement_is_held(tmp_path):
    """Oracle: the measurements of the experiment, the last one where one is missing, and r(0) before the first one."""
    (tmp_path / "tank.py").write_text(TANK)
    law = "{sum: [{gaussian: {std: 0.02}}, {missing: {probability: 0.5}}]}"
    path = tmp_path / "trained.yaml"
    path.write_text(CONFIG.replace("measurement: {gaussian: {std: 0.02}}", f"measurement: {law}"))
    experiment = rmpc_bench.load_config(path).experiment
    for run in range(4):
        lost = experiment.scenario.draw(experiment.plant, range(run, run + 1), 25).alterations[0].drawn[0, :, 0] > 0.0
        made, expected = env(path), 0.3
        observation, _ = made.reset(options={"run": run})
        for k in range(25):
            expected = expected if lost[k] else made.unwrapped.episode.sample.y[0]
            assert observation[0] == expected and np.isnan(made.unwrapped.episode.sample.y[0]) == lost[k]
            observation, *_ = made.step(np.array([0.2]))
    assert lost.any() and not lost.all()
