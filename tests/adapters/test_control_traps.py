"""What goes wrong with systems of python-control: every test has the naive form beside that of the adapter."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("control")

import control
from adapters import control_systems as systems
from small_experiment import cli, ran, write

from rmpc_bench.adapters.control import model, nonlinear, plant
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.types import DesignError, Parameters

NOISE = DesignNoise(1e-6, 4e-6)
TIGHT = {"rtol": 1e-10, "atol": 1e-12}


def test_the_input_is_held():
    """`input_output_response` interpolates the input linearly, by far more than the integration error."""
    made, steps = systems.tanks(), 20
    times, u = systems.TS * np.arange(steps + 1), np.where(np.arange(steps + 1) % 4 < 2, 4.0, 12.0)
    naive = control.input_output_response(made, times, u, systems.X0, solve_ivp_kwargs=TIGHT).states.T
    fine = np.linspace(0.0, systems.TS, 3)
    held, x = [systems.X0], systems.X0
    for k in range(steps):
        x = control.input_output_response(made, fine, np.full(3, u[k]), x, solve_ivp_kwargs=TIGHT).states[:, -1]
        held.append(x)
    bench, ours = plant(systems.TS, steps, control=made, x0=systems.X0), [systems.X0]
    delta = bench.draw({name: np.array([value]) for name, value in bench.nominal.items()}, [], steps)
    for k in range(steps):
        ours.append(bench.step(k, delta, ours[-1][None], u[k, None, None], np.zeros((1, 2))).x[0])
    assert np.abs(naive - held).max() > 1e-3
    np.testing.assert_allclose(ours, held, rtol=0, atol=1e-9)


def test_parameters_belong_to_the_run():
    """A call without parameters has the nominal ones, and a call of `_rhs` those of the last run."""
    made, x, u = systems.with_actuator(), np.array([0.1, 0.1, 8.0]), np.array([8.0])
    wide, usual = {**systems.PARAMETERS, "a1": 1e-5}, systems.PARAMETERS
    equation = nonlinear(made, {}, systems.TS)
    of_wide, of_usual = (equation.rhs(0.0, x, u, Parameters(each)) for each in (wide, usual))
    assert np.abs(of_wide - of_usual).max() > 1e-4
    # Naive: parameters once per run, and runs one sample after the other.
    made._update_params(wide)
    made._update_params(usual)
    naive = made._rhs(0.0, x, u)
    np.testing.assert_array_equal(naive, of_usual)
    assert np.abs(naive - of_wide).max() > 1e-4
    np.testing.assert_array_equal(made.dynamics(0.0, x, u), of_usual)
    np.testing.assert_array_equal(equation.rhs(0.0, x, u, Parameters(wide)), of_wide)


@pytest.mark.parametrize("dt", [0.5, 2 * systems.TS])
def test_another_sampling_time_is_refused(dt):
    """The naive plant, which applies the map once per sample, runs at another speed."""
    names = {"states": 1, "inputs": 1, "dt": dt}
    discrete = control.nlsys(lambda t, x, u, params: [0.5 * x[0] + u[0]], None, **names)
    for given in (discrete, control.ss([[0.5]], [[1.0]], [[1.0]], 0, dt), lambda: control.tf([1.0], [1.0, -0.5], dt)):
        with pytest.raises(DesignError, match=rf"sampling time {dt:g}, and time.step is {systems.TS:g}"):
            plant(systems.TS, 10, control=given)


def test_a_system_without_time_base_is_refused():
    """`dt = None` may be a continuous or a discrete system."""
    given = control.ss([[0.5]], [[1.0]], [[1.0]], 0, None)
    with pytest.raises(DesignError, match="no time base"):
        plant(0.1, 10, control=given)


@pytest.mark.parametrize(
    "given",
    [
        lambda: systems.tanks(output=lambda t, x, u, params: [x[1] + 1e-6 * u[0]]),
    ],
)
def test_a_nonlinear_output_of_the_input_is_refused(given):
    """Without the refusal y(k) would be that of u = 0."""
    bounds = {"bounds": systems.BOUNDS}
    with pytest.raises(DesignError, match="its output depends on the input"):
        plant(systems.TS, 10, control=given, **bounds)
    with pytest.raises(DesignError, match="its output depends on the input"):
        model(systems.TS, plant(systems.TS, 10, control=systems.tanks()), control=given, noise=NOISE)


def test_other_systems_are_refused():
    """Frequency responses have no states, and a misspelt parameter is named."""
    with pytest.raises(DesignError, match="must be or return a StateSpace"):
        plant(0.1, 10, control=control.frd([1.0, 0.5], [1.0, 2.0]))
    with pytest.raises(DesignError, match="did you mean 'k'"):
        plant(0.1, 10, control=systems.oscillator, parameters={"kk": 1.0})
    with pytest.raises(DesignError, match="m, which has no value"):
        plant(0.1, 10, control=lambda m: systems.oscillator(m))
    with pytest.raises(DesignError, match="did you mean 'area'"):
        plant(systems.TS, 10, control=systems.tanks(), parameters={"aera": 1.0})


FILE = """
import control

def oscillator(m, k=2.0):
    if k > 2.3:
        raise ValueError(f"too stiff: {k > 2.3}")
    names = {"states": ["s", "v"], "inputs": ["f"], "outputs": ["s"]}
    return control.ss([[0, 1], [-k / m, -0.3]], [[0], [1 / m]], [[1, 0]], 0, **names)

pendulum = control.nlsys(
    lambda t, x, u, params: [x[1], -params["k"] * x[0] + u[0]], lambda t, x, u, params: [x[0]],
    states=["s", "v"], inputs=["f"], outputs=["s"], params={"k": 2.0})
"""
KEYS = {
    "uncertainty": "{eps: +-20%}",
    "model": "{linearise: plant, at: {u: 0, guess: 0}, noise: {process: 1e-4, measurement: 1e-4}}",
    "noise": "{process: {gaussian: {std: 0.01}}, measurement: {gaussian: {std: 0.01}}}",
    "reference": "{kind: constant, value: 0}",
    "initial": "{x: [1, 0], x_hat: 0, P: 1}",
    "controller": "{kind: control-lqr, Q_x: 1, R_u: 0.1}",
    "methods": "{LQE: {estimator: {kind: control-lqe}}, Kalman: {estimator: {kind: kalman}}}",
    "metrics": "[mse, estimation_mse]",
}


def experiment(directory, plant_keys, **changes):
    """Write a configuration with a system of a file."""
    (directory / "own.py").write_text(FILE, encoding="utf-8")
    return write(directory, plant=plant_keys, **{**KEYS, **changes})


@pytest.mark.parametrize("block", [2, 5])
@pytest.mark.long
def test_lambdas_reach_the_workers(block, tmp_path):
    """A system with lambdas cannot be pickled; workers load it by its path: same bytes for any workers and blocks."""
    import pickle

    with pytest.raises((AttributeError, pickle.PicklingError)):
        pickle.dumps(control.nlsys(lambda t, x, u, params: [0.0], None, states=1, inputs=1))
    path = experiment(tmp_path, "{control: own.py:pendulum, perturb: {k: 1 + eps}}", execution=f"{{block: {block}}}")
    alone = ran(path, tmp_path / "one")
    assert alone == ran(path, tmp_path / "two", jobs=2)
    other = experiment(tmp_path, "{control: own.py:pendulum, perturb: {k: 1 + eps}}", execution="{block: 3}")
    assert alone == ran(other, tmp_path / "three")


def test_matrices_that_cannot_be_made_end_their_run_only(tmp_path):
    """The function raises for some parameters; the reason is in the record of the run."""
    path = experiment(tmp_path, "{control: own.py:oscillator, parameters: {m: 1}, perturb: {k: 1 + eps}}", runs="8")
    result = cli("run", path, "-o", tmp_path / "out", "--progress", "none", "-j", 1)
    rows = (tmp_path / "out" / "trials.csv").read_text().splitlines()
    crashed = [row for row in rows if "crashed" in row]
    assert 0 < len(crashed) < len(rows) - 1, result.output
    assert "ValueError: too stiff" in next((tmp_path / "out" / "failures").iterdir()).read_text()


def test_messages_have_their_place(tmp_path, capsys):
    """The key of the system, and the parameter that is missing."""
    path = experiment(tmp_path, "{control: own.py:oscillator}")
    result = cli("check", path)
    assert result.exit_code == 2
    assert "plant.control: oscillator takes m, which has no value; give parameters: {m: ..}" in result.stderr
    path = experiment(tmp_path, "{control: own.py:pendulum, bounds: {q: [0, 1]}}")
    assert "did you mean" in cli("check", path).stderr or "known" in cli("check", path).stderr


def test_the_library_is_imported_on_use():
    """`list` and `describe` do not need it."""
    code = (
        "import sys; from click.testing import CliRunner; from rmpc_bench.cli import main\n"
        "for each in (['list', 'plants'], ['describe', 'control-lqe'], ['describe', 'plants/control'], "
        "['describe', 'plants/scipy']):\n"
        "    assert CliRunner().invoke(main, each).exit_code == 0, each\n"
        "print([name for name in ('control', 'scipy.signal') if name in sys.modules])"
    )
    place = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=place, check=True)
    assert json.loads(done.stdout.replace("'", '"')) == []
