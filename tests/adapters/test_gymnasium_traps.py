"""What the adapter of Gymnasium finds out about an environment, and says."""

from pathlib import Path

import numpy as np
import pytest
from conftest import ROUND

gymnasium = pytest.importorskip("gymnasium")

from adapters import gymnasium_environments as environments  # noqa: E402
from adapters.test_gymnasium import design, inputs, simulated  # noqa: E402
from small_experiment import cli  # noqa: E402

import rmpc_bench  # noqa: E402

BY_ACTION = "draws other random numbers after other actions"


def remarks(**keys):
    """Return the remarks on a plant, as one text."""
    return " ".join(design(0.1, 10, **keys).remarks)


def test_noise_that_depends_on_actions_is_said():
    """The naive pairing (equal seeds) gives two methods different noise; noise of every step is paired."""
    noise = {}
    for kind in (environments.Noisy, environments.NoisyByAction):
        plant = design(0.1, 30, env=kind, state="x")
        u = inputs(1, 30, 0.1)
        first, second = (simulated(plant, each, runs=range(1))[0] for each in (u, -u))
        # What the noise was: the rest of the recursion.
        noise[kind] = [r.x[0, 1:] - 0.9 * r.x[0, :-1] - r.u[0] for r in (first, second)]
    np.testing.assert_allclose(*noise[environments.Noisy], atol=1e-15)  # rounding of sums
    naive = noise[environments.NoisyByAction]
    assert np.abs(naive[0] - naive[1]).max() > 0.01
    assert BY_ACTION in remarks(env=environments.NoisyByAction, state="x")
    assert BY_ACTION not in remarks(env=environments.Noisy, state="x")


def test_random_numbers_without_a_seed_are_said():
    """Such an environment gives another run every time; its trials are not shared."""
    plant = design(0.1, 10, env=environments.Unseeded, state="x")
    assert not plant.deterministic
    assert "runs cannot be repeated" in " ".join(plant.remarks)
    assert design(0.1, 10, env=environments.Lag, state="x").deterministic


def test_the_same_environment_every_time_is_refused():
    """Naive form: the runs of all methods move one environment in turn."""
    one = environments.Lag()
    with pytest.raises(rmpc_bench.types.DesignError, match="same environment every time: make a new one") as caught:
        design(0.1, 10, env=lambda: one, state="x")
    assert caught.value.parameter == "env"


def test_parameters_are_keywords_or_attributes():
    """A keyword of the class is given to it, an attribute is set; what depends on it needs `set_parameters`."""
    u = np.zeros((1, 5, 1))
    changed = {"pole": lambda named: 0.5}
    plant = design(0.1, 5, env=environments.Lag, state="x", parameters={"pole": 0.9})
    x = simulated(plant, u, runs=range(1), parameters=changed)[0].x[0]
    np.testing.assert_allclose(x[1:], 0.5 * x[:-1], **ROUND)
    # The naive way sets the gain, and the environment goes on with the square that it has computed before.
    assert "the parameter gain by 10 % changes no state" in remarks(
        env=environments.Lag, state="x", parameters={"gain": 1.0}
    )
    given = {"env": environments.Lag, "state": "x", "parameters": {"gain": 1.0}}
    plant = design(0.1, 5, **given, set_parameters=environments.set_gain)
    assert "gain" not in " ".join(plant.remarks)
    x = simulated(plant, u + 0.1, runs=range(1), parameters={"gain": lambda named: 2.0})[0].x[0]
    np.testing.assert_allclose(x[1:], 0.9 * x[:-1] + 0.4, **ROUND)


def test_actions_are_rounded_only_where_needed():
    """The naive cast to float32 changes the numbers of every environment."""
    u = inputs(1, 10, 0.3)
    exact = simulated(design(0.1, 10, env=environments.Lag, state="x"), u, runs=range(1))[0].x
    rounded = design(0.1, 10, env=environments.Single, state="x")
    assert "rounded to float32" in " ".join(rounded.remarks)
    naive = simulated(rounded, u, runs=range(1))[0].x
    assert 0.0 < np.abs(naive - exact).max() < 1e-7


def test_state_by_functions():
    """Reading and writing by functions of the user is as by the attribute."""
    u = inputs(2, 10, 0.3)
    by_name = design(0.1, 10, env=environments.Lag, state="x", start="initial")
    functions = {"state": environments.get_x, "set_state": environments.set_x}
    by_function = design(0.1, 10, env=environments.Lag, **functions, start="initial")
    pair = [simulated(each, u, runs=range(2), x0=[0.7])[0].x for each in (by_name, by_function)]
    np.testing.assert_array_equal(*pair)
    assert design(0.1, 10, env=environments.Lag, state=environments.get_x).nw == 0


def test_another_sampling_time_is_said():
    """A sample is a step of the environment, whatever `time.step` is."""
    assert "a step of the environment takes 0.05 s, and `time.step` is 0.1 s" in remarks(
        env="Pendulum-v1", state="state"
    )
    assert "takes" not in " ".join(design(0.05, 10, env="Pendulum-v1", state="state").remarks)


def test_an_output_function_of_the_state():
    """Oracle: the function itself."""
    plant = design(
        0.05, 8, env="Pendulum-v1", state="state", output=lambda x, p: [np.sin(x[0]) * p.l], outputs=["height"],
        parameters={"l": 1.0},
    )  # fmt: skip
    record = simulated(plant, inputs(2, 8), runs=range(2))[0]
    np.testing.assert_array_equal(record.y[:, :, 0], np.sin(record.x[:, :, 0]))
    assert plant.names["y.0"] == "height"


PAIRED = """\
version: 1
name: noisy
runs: 4
time: {step: 0.1, steps: 10}
plant: {env: noisy_env.py:NoisyByAction, state: x}
model: {kind: linear, A: 0.9, B: [[1]], C: [[1]], P_w: 1e-2, P_v: 1e-3}
reference: {kind: constant, value: 0.3}
controller: {kind: lqr, horizon: 10, Q_x: 1, R_u: 1}
methods:
  a: {estimator: {kind: kalman}}
  b: {estimator: {kind: robust-kalman, c: 0.1}}
metrics: [mse]
figures: []
"""


def test_the_report_lists_it(tmp_path):
    """Among the limitations of the comparison; the stored results say it without the environment."""
    source = Path(environments.__file__).read_text(encoding="utf-8")
    (tmp_path / "noisy_env.py").write_text(source, encoding="utf-8")
    path = tmp_path / "noisy.yaml"
    path.write_text(PAIRED.replace("reference: {kind: constant, value: 0.3}\n", ""), encoding="utf-8")
    results = rmpc_bench.run(rmpc_bench.load_config(path), directory=tmp_path / "out", engine="serial")
    assert len(results.trials.limitations) == 1
    rmpc_bench.publish(results)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"The environment {BY_ACTION}" in " ".join(page.split())


def test_run_says_that_equal_methods_differ(tmp_path):
    """A class attribute that `step` changes is shared by all runs and methods: the verdict stands beside a sentence."""
    source = Path(environments.__file__).read_text(encoding="utf-8")
    (tmp_path / "noisy_env.py").write_text(source, encoding="utf-8")
    path = tmp_path / "noisy.yaml"
    text = PAIRED.replace("NoisyByAction", "Worn").replace("{kind: robust-kalman, c: 0.1}", "{kind: kalman}")
    path.write_text(text.replace("reference: {kind: constant, value: 0.3}\n", ""), encoding="utf-8")
    done = cli("run", path, "-o", tmp_path / "out", "-j", "1")
    assert done.exit_code == 0, done.output
    sentence = "Equal seeds and actions give different states, so that equal methods differ and runs cannot be repeated"
    assert sentence in " ".join(done.stdout.split())
    assert f"## Limitations\n\n- {sentence}" in (tmp_path / "out" / "tables" / "summary.md").read_text(encoding="utf-8")
