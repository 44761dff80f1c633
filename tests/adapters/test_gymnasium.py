"""Environments of Gymnasium as plants: against the same equations in NumPy, and in a whole experiment."""

import subprocess
import sys

import numpy as np
import pytest
from conftest import ROUND

gymnasium = pytest.importorskip("gymnasium")

from adapters import gymnasium_environments as environments  # noqa: E402

import rmpc_bench  # noqa: E402
from rmpc_bench import registry  # noqa: E402
from rmpc_bench.conformance.plants import no_estimate  # noqa: E402
from rmpc_bench.conformance.systems import Excitation  # noqa: E402
from rmpc_bench.simulation.closed_loop import simulate  # noqa: E402
from rmpc_bench.simulation.random_streams import stream  # noqa: E402
from rmpc_bench.simulation.reference import Constant  # noqa: E402
from rmpc_bench.simulation.run_start import RunStart  # noqa: E402
from rmpc_bench.simulation.scenario import Scenario  # noqa: E402
from rmpc_bench.types import DesignError, Journal, Method, Status  # noqa: E402

design = registry.get("plants", "env")
PENDULUM = {"env": "Pendulum-v1", "state": "state", "states": {"theta": "rad", "omega": "rad/s"}}


def simulated(plant, u, *, seed=1, runs=range(3), x0=None, process=(), parameters=None):
    """Simulate runs with inputs from outside; return the record, the statuses and the journal."""
    n_steps = u.shape[1]
    zero = np.zeros(plant.nx) if x0 is None else np.asarray(x0, dtype=float)
    scenario = Scenario(seed, {}, parameters or {}, zero, (), process, (), Constant(np.zeros(plant.ny)))
    draws = scenario.draw(plant, runs, n_steps)
    method = Method("open", no_estimate(plant.nx), Excitation(u))
    start = RunStart(seed, tuple(runs), Journal())
    r = scenario.reference.sample(n_steps + 1)
    return (*simulate(plant, method, draws, r, n_steps, start=start), start.journal)


def inputs(n_runs, n_steps, size=1.5):
    """Return inputs that vary."""
    return size * np.sin(np.arange(n_runs)[:, None, None] + 0.1 * np.arange(n_steps)[None, :, None] ** 1.3)


def pendulum(x0, u, *, g=10.0, m=1.0, l=1.0, dt=0.05):  # noqa: E741
    """Compute Pendulum-v1 in double precision: semi-implicit Euler, as its documentation has it."""
    theta, omega = x0
    found = [[theta, omega]]
    for torque in np.clip(u, -2.0, 2.0):
        omega = omega + (3.0 * g / (2.0 * l) * np.sin(theta) + 3.0 / (m * l**2) * torque) * dt
        omega = np.clip(omega, -8.0, 8.0)
        theta = theta + omega * dt
        found.append([theta, omega])
    return np.array(found)


def test_pendulum_is_its_equation():
    """Oracle: the documented equations, in double precision; the initial state from the seed of the run."""
    plant = design(0.05, 60, **PENDULUM, parameters={"m": 1.0, "g": 10.0})
    u = inputs(3, 60)
    record, status, journal = simulated(plant, u, parameters={"m": lambda named: 1.3, "g": lambda named: 9.0})
    assert not status.any()
    for run in range(3):
        seed = int(stream(1, run, "own/plant").integers(2**31))
        first = gymnasium.make("Pendulum-v1").unwrapped
        first.reset(seed=seed)
        np.testing.assert_array_equal(record.x[run, 0], first.state)
        np.testing.assert_allclose(record.x[run], pendulum(first.state, u[run, :, 0], m=1.3, g=9.0), **ROUND)
    assert len({tuple(x) for x in record.x[:, 0]}) == 3


def test_the_state_attribute_is_not_rounded():
    """The naive adapter takes the observation, which is rounded to float32."""
    u = inputs(1, 60)
    exact = simulated(design(0.05, 60, **PENDULUM), u, runs=range(1))[0].x[0]
    naive = simulated(design(0.05, 60, env="Pendulum-v1"), u, runs=range(1))[0].x[0]
    assert 1e-9 < np.abs(naive[:, 2] - exact[:, 1]).max() < 1e-6
    np.testing.assert_allclose(np.cos(exact[:, 0]), naive[:, 0], atol=1e-7)  # float32
    assert "float32" in " ".join(design(0.05, 60, env="Pendulum-v1").remarks)


def test_no_time_limit():
    """The naive environment truncates after 200 steps; the plant does not, and keeps to the equation beyond."""
    naive = gymnasium.make("Pendulum-v1")
    naive.reset(seed=1)
    ends = [naive.step(np.zeros(1, np.float32))[3] for _ in range(220)]
    assert ends.index(True) == 199
    u = inputs(2, 220, 0.5)
    record, status, _ = simulated(design(0.05, 220, **PENDULUM), u, runs=range(2))
    assert not status.any()
    np.testing.assert_allclose(record.x[1], pendulum(record.x[1, 0], u[1, :, 0]), rtol=1e-9)  # 220 steps, unstable


def test_inputs_are_limited_and_counted():
    """Oracle: the count of the inputs beyond the box."""
    plant = design(0.05, 30, **PENDULUM)
    u = inputs(3, 30, 4.0)
    record, _, journal = simulated(plant, u)
    assert journal.warnings == {"input u.0 limited to [-2, 2]": int((np.abs(u) > 2.0).sum())}
    np.testing.assert_allclose(record.x[2], pendulum(record.x[2, 0], u[2, :, 0]), **ROUND)
    narrower = design(0.05, 30, **PENDULUM, inputs={"torque": "N m"}, bounds={"torque": (-1.0, 5.0)})
    assert narrower.signals.bounds["torque"] == (-1.0, 2.0)


def test_x0_of_the_configuration_and_process_noise():
    """`start: initial` writes x(0), and w is added to the state, which the environment continues from."""
    from rmpc_bench.noise.gaussian import Gaussian

    plant = design(0.05, 20, **PENDULUM, start="initial")
    assert (plant.nw, plant.has_own_start) == (2, False)
    noise = Gaussian(np.zeros(2), np.diag([0.01, 0.1]))
    u = inputs(2, 20)
    record, _, _ = simulated(plant, u, x0=[3.0, 0.5], process=(noise,), runs=range(2))
    assert (record.x[:, 0] == [3.0, 0.5]).all()
    for run in range(2):
        w = noise.draw(stream(1, run, "w/0"), 21)
        for k in range(20):
            moved = pendulum(record.x[run, k], u[run, k : k + 1, 0])[1]
            np.testing.assert_allclose(record.x[run, k + 1], moved + w[k], rtol=1e-12, atol=1e-13)


def test_methods_and_blocks_are_apart():
    """The same run alone, in another block and for the second method: the same bits."""
    plant = design(0.05, 15, env=environments.Noisy, state="x")
    u = inputs(4, 15, 0.3)
    all_runs = simulated(plant, u, runs=range(4))[0].x
    np.testing.assert_array_equal(simulated(plant, u, runs=range(4))[0].x, all_runs)
    np.testing.assert_array_equal(simulated(plant, u[2:3], runs=range(2, 3))[0].x, all_runs[2:3])
    assert ("random numbers", "the same for every action") in plant.facts()


def test_discrete_actions():
    """The action whose value is nearest to u is applied, and u is that value; oracle: the environment alone."""
    plant = design(0.02, 6, env="CartPole-v1", state="state", action=[-10.0, 10.0])
    u = np.array([[[-3.0], [0.1], [12.0], [-0.1], [0.0], [9.0]]])
    record, _, journal = simulated(plant, u, runs=range(1))
    alone = gymnasium.make("CartPole-v1").unwrapped
    alone.reset(seed=int(stream(1, 0, "own/plant").integers(2**31)))
    expected = [alone.state, *(alone.step(a) and alone.state for a in (0, 1, 1, 0, 0, 1))]
    np.testing.assert_array_equal(record.x[0], expected)
    np.testing.assert_array_equal(record.u[0, :, 0], [-10.0, 10.0, 10.0, -10.0, -10.0, 10.0])
    np.testing.assert_array_equal(record.u_command, u)
    assert journal.warnings == {"input u.0 limited to [-10, 10]": 1}


def test_terminated_ends_the_run_with_a_word():
    """Oracle: the step at which the environment alone terminates."""
    u = np.ones((2, 60, 1))
    for ends in (True, False):
        keys = {"terminated": "end" if ends else "ignore"}
        plant = design(0.02, 60, env=environments.Lag, state="x", **keys)
        record, status, journal = simulated(plant, u, runs=range(2))
        if not ends:
            assert not status.any()
            assert (np.abs(record.x[:, -1]) > 5.0).all()
            continue
        assert (status == Status.OUT_OF_RANGE).all()
        failure = journal.failures[1]
        assert failure.message == "the environment has terminated the episode"
        x, k = record.x[1, 0], 0
        while abs(x[0]) <= 5.0:
            x, k = 0.9 * x + 1.0, k + 1
        assert failure.k == k - 1


def test_wrappers_of_a_registration_stay():
    """`unwrapped` alone would drop them; the time limit goes all the same."""
    if "Wrapped-v0" not in gymnasium.registry:
        spec = gymnasium.envs.registration.WrapperSpec("Doubled", "adapters.gymnasium_environments:Doubled", {})
        gymnasium.register("Wrapped-v0", environments.Lag, max_episode_steps=5, additional_wrappers=(spec,))
    plant = design(0.02, 10, env="Wrapped-v0", state="x", output=["observation.0"])
    u = 0.1 * np.ones((1, 10, 1))
    record, status, _ = simulated(plant, u, runs=range(1))
    assert not status.any()
    np.testing.assert_allclose(record.x[0, 1:], 0.9 * record.x[0, :-1] + 0.2, **ROUND)
    np.testing.assert_allclose(record.y, record.x, rtol=1e-6)  # float32
    assert "wrappers of its registration stay: Doubled" in " ".join(plant.remarks)


@pytest.mark.parametrize(
    ("keys", "place", "text"),
    [
        ({"env": "Pendulumm-v1"}, "env", "Did you mean: `Pendulum`?"),
        ({"env": "Pendulum-v1", "options": {"gg": 1}}, "env", "unexpected keyword argument 'gg'"),
        ({"env": "no_such_package:Name-v0"}, "env", "no_such_package belongs to no installed distribution"),
        *(
            ({"env": "Pendulum-v1", "options": {"g": value}}, "options.g", "no_such_package belongs to no installed")
            for value in ({"a": ["no_such_package:Name-v0"]}, {"no_such_package:Name-v0": 1}, ["no_such_package:N"])
        ),
        ({"env": "CartPole-v1"}, "action", "2 discrete actions"),
        ({"env": "CartPole-v1", "action": [1.0]}, "action", "has 1 values; the environment has 2 actions"),
        ({"env": "Pendulum-v1", "parameters": {"mm": 1.0}}, "parameters.mm", "did you mean 'm'?"),
        ({"env": "Pendulum-v1", "state": "stat"}, "state", "no attribute 'stat'"),
        ({"env": "Pendulum-v1", "states": ["a"]}, "states", "has 1 names; the environment has 3 states"),
        ({"env": "Pendulum-v1", "output": ["thet"]}, "output", "'thet' is not a known state or observation"),
        ({"env": "Pendulum-v1", "start": "initial"}, "start", "the state cannot be set"),
        ({"env": environments.Mapped}, "state", "the observation is a Dict"),
    ],
)
def test_errors(keys, place, text):
    """Every message names the key to blame."""
    with pytest.raises(DesignError, match=".") as error:
        design(0.05, 10, **keys)
    assert error.value.parameter == place
    assert text in str(error.value)


CONFIG = """\
version: 1
name: envs
seed: 3
runs: 6
time: {{step: 0.05, steps: 30}}
uncertainty: {{eps: +-20%}}
plant: {{env: Pendulum-v1, state: state, parameters: {{m: 1}}, perturb: {{m: 1 + eps}}{more}}}
model: {{kind: linear, A: [[1, 0.05], [0.75, 1]], B: [[0], [0.15]], C: [[1, 0], [0, 1]], P_w: 1e-4, P_v: 1e-4}}
noise: {{measurement: {{gaussian: {{std: 0.01}}}}}}
initial: {initial}
controller: {{file: law.py:PD, K: 5}}
methods:
  a: {{estimator: {{kind: kalman}}}}
  b: {{estimator: {{kind: kalman}}, controller: {{file: law.py:PD, K: 5, unused: 2}}}}
metrics: [mse, input_power]
execution: {{block: {block}}}
"""
LAW = """\
from rmpc_bench import single_run
@single_run
class PD:
    def __init__(self, K: float = 1.0, unused: float = 1.0): self.K = K
    def control(self, x_hat): return [-self.K * x_hat[0] - x_hat[1]]
"""


def written(directory, *, more="", initial="{x_hat: 0, P: 1}", block=4):
    """Write a configuration with a law of two equal methods."""
    (directory / "law.py").write_text(LAW)
    path = directory / "envs.yaml"
    path.write_text(CONFIG.format(more=more, initial=initial, block=block))
    return path


def test_two_equal_methods_have_equal_rows(tmp_path):
    """Also in blocks of another length, and after the run is replayed alone."""
    config = rmpc_bench.load_config(written(tmp_path))
    frame = rmpc_bench.run(config, directory=tmp_path / "one", engine="serial").trials.frame
    a, b = (frame[frame["method"] == name].drop(columns="method").reset_index(drop=True) for name in "ab")
    assert a.equals(b)
    assert (a["status"] == "ok").all()
    assert a["mse"].nunique() == 6
    other = rmpc_bench.load_config(written(tmp_path, block=1))
    assert rmpc_bench.run(other, directory=tmp_path / "two", engine="serial").trials.frame.equals(frame)
    again = rmpc_bench.replay(tmp_path / "one", 4, "b")
    assert (again.status, again.differing) == ("ok", {})


def test_initial_x_beside_a_start_of_the_environment(tmp_path):
    """It would have no effect; the error has its place and the way out, which works."""
    given = "{x: [0.1, 0], x_hat: 0, P: 1}"
    with pytest.raises(rmpc_bench.types.ConfigError, match=r"envs.yaml:10:\d+: initial.x: .*plant.start: initial"):
        rmpc_bench.load_config(written(tmp_path, initial=given))
    config = rmpc_bench.load_config(written(tmp_path, more=", start: initial", initial=given))
    x0 = config.experiment.scenario.draw(config.experiment.plant, range(2), 5).x0
    assert (x0 == [0.1, 0.0]).all()
    assert config.experiment.plant.remarks[0] == "x(0) is that of `initial`"


def test_versions_of_the_library_and_of_the_package(tmp_path):
    """An environment ``package:Name-v0`` is one of that package, too."""
    config = rmpc_bench.load_config(written(tmp_path))
    assert {"gymnasium"} <= {*config.points[0].modules["a"]}
    path = written(tmp_path, more=", options: {g: 9.81}")
    path.write_text(path.read_text().replace("Pendulum-v1", "gymnasium.envs:Pendulum-v1"))
    named = rmpc_bench.load_config(path)
    assert {"gymnasium"} <= {*named.points[0].modules["a"]}
    path.write_text(path.read_text().replace("gymnasium.envs:Pendulum-v1", "numpy.linalg:Pendulum-v1"))
    assert {"gymnasium", "numpy"} <= {*rmpc_bench.load_config(path).points[0].modules["a"]}


def test_other_commands_do_not_import_it():
    """Oracle: the modules of a process that lists, describes and checks what uses no library."""
    code = (
        "import sys\nfrom rmpc_bench.cli import main\n"
        "for words in (['--help'], ['list'], ['describe', 'kalman'], ['check', 'configs/quickstart.yaml']):\n"
        "    try:\n        main(words)\n    except SystemExit:\n        pass\n"
        "assert 'gymnasium' not in sys.modules and 'xarray' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
