"""Design models made from the plant of a configuration: nominal parameters, identity, places of errors."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from plants import tanks

from rmpc_bench.cli.check import check
from rmpc_bench.config.load import load_config
from rmpc_bench.types import ConfigError

TEXT = """
version: 1
name: tanks
seed: 1
runs: 4
time: {step: 2, steps: 10}
uncertainty: {eps: {dist: uniform, low: 0.4, high: 0.5}}
plant:
  ode: tanks.py:rhs
  output: tanks.py:output
  states: {h1: m, h2: m}
  inputs: {pump: ml/s}
  outputs: {level: m}
  parameters: {a1: 7.1e-6, a2: 6.3e-6, k: 1}
  bounds: {h1: [1.0e-4, 0.6], pump: [0, 30]}
  perturb: {a1: 1 + eps}
model: {linearise: plant, at: {u: 8, guess: 0.1}, noise: {process: 1.0e-7, measurement: 4.0e-6}}
noise: {measurement: {gaussian: {cov: 4.0e-6}}}
initial: {x: [0.06, 0.08], x_hat: [0.065, 0.085], P: 1.0e-4}
reference: {kind: constant, value: 0.1}
methods:
  KF: {estimator: {kind: kalman}}
controller: {kind: mpc, Hp: 20, Hu: 3, Q: 1, R: 1.0e-6, limits: {u: [0, 30]}}
metrics: [mse]
"""
PERTURB = "perturb: {a1: 1 + eps}"
MODEL = "model: {linearise: plant, at: {u: 8, guess: 0.1}, noise: {process: 1.0e-7, measurement: 4.0e-6}}"


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the configuration with some texts replaced."""
    (tmp_path / "tanks.py").write_text(Path(tanks.__file__).read_text(encoding="utf-8"), encoding="utf-8")

    def loaded(*changes):
        text = TEXT
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "tanks.yaml").write_text(text, encoding="utf-8")
        return load_config(tmp_path / "tanks.yaml")

    return loaded


def test_a_model_has_the_nominal_parameters(load):
    """`perturb` and `set` change the plant of a run; the naive model of the drawn plant has other gains."""
    configs = [
        load(),
        load(("perturb: {a1: 1 + eps}", "set: {a1: 1e-5 + eps}")),
        load(("  perturb: {a1: 1 + eps}", "")),
    ]
    expected = tanks.steady_state(8.0, tanks.PARAMETERS)
    for config in configs:
        (facts,) = config.model_facts
        assert facts.where == "model"
        assert dict(facts.facts)["operating point"].startswith(f"h1 = {expected[0]:.6g} m, h2 = {expected[1]:.6g} m")
    gains = [config.experiment.methods[0].controller.K_x for config in configs]
    np.testing.assert_array_equal(gains[0], gains[1])
    np.testing.assert_array_equal(gains[0], gains[2])


def test_the_nominal_plant_identifies_the_method(load):
    """Another nominal parameter is another method; another `perturb` is another experiment with the same method."""
    changes = ((), (("1 + eps", "1 + 2*eps"),), (("a2: 6.3e-6", "a2: 6.4e-6"),))
    first, perturbed, changed = (load(*each).points[0] for each in changes)
    assert first.methods == perturbed.methods
    assert first.experiment_hash != perturbed.experiment_hash
    assert first.methods != changed.methods
    assert "perturb" not in first.methods["KF"]["nominal_plant"]


def test_points_of_a_sweep_have_models_of_their_own(load):
    """A swept nominal parameter moves the operating point; the design of the first point is not shared."""
    config = load(("metrics: [mse]", "metrics: [mse]\nsweep: {grid: {plant.parameters.a1: [7.1e-6, 9.0e-6]}}"))
    x_op = [point.experiment.methods[0].estimator.f for point in config.points]
    assert not np.array_equal(*x_op)


def test_a_model_without_the_plant_keeps_its_identity(load):
    """Models that are not made from the plant do not contain it."""
    own = "{kind: linear, A: [0.9, 0.8], B: [[1], [0]], C: [[0, 1]], P_w: 1.0e-7, P_v: 4.0e-6}"
    config = load((MODEL, f"model: {own}"))
    assert sorted(config.points[0].methods["KF"]) == ["P", "controller", "estimator", "model", "x_hat"]


# what is replaced, by what, the key of the problem, words of the message
MISTAKES = {
    "unknown": ("at: {u: 8, guess: 0.1}", "at: {u: {pum: 8}}", "model.at.u", "'pump'"),
    "outside": ("at: {u: 8, guess: 0.1}", "at: {u: 80, guess: 0.1}", "model.at.u", "outside the bounds"),
    "word": ("at: {u: 8, guess: 0.1}", "at: steady", "model.at", "trajectory"),
    "no noise": (", noise: {process: 1.0e-7, measurement: 4.0e-6}", "", "model", "'noise' is missing"),
    "not the plant": ("linearise: plant", "linearise: plnt", "model.linearise", "'plant'"),
    "covariance": ("process: 1.0e-7", "process: -1", "model.noise.process", "positive semidefinite"),
    "nonlinear": ("{linearise: plant, at: {u: 8, guess: 0.1}", "{nonlinear: plant", "methods.KF.estimator.kind",
                  "linearise: plant"),
    "regulator": ("kind: mpc, Hp: 20, Hu: 3, Q: 1, R: 1.0e-6, limits: {u: [0, 30]}",
                  "kind: lqr, horizon: 10, Q_x: 1, R_u: 1.0e-6", "reference", "y = 0.0821863838"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_reported_at_its_key(load, name):
    """With the line and the column, and never as an error of the bench."""
    old, new, key, words = MISTAKES[name]
    with pytest.raises(ConfigError) as found:
        load((old, new))
    assert [key] == sorted({problem.path for problem in found.value.problems})
    assert words in str(found.value)
    assert all(problem.line > 1 for problem in found.value.problems)


def test_a_regulator_may_be_used_at_its_operating_point(load):
    """The reference is the output there, to six digits."""
    config = load(("kind: mpc, Hp: 20, Hu: 3, Q: 1, R: 1.0e-6, limits: {u: [0, 30]}",
                   "kind: lqr, horizon: 10, Q_x: 1, R_u: 1.0e-6"), ("at: {u: 8,", "at: {y: 0.1,"))  # fmt: skip
    np.testing.assert_allclose(config.experiment.methods[0].controller.regulates_to, 0.1, rtol=1e-9)


def test_a_missing_initial_estimate_is_warned_of(load):
    """Estimates would start at 0, which for a tank is empty."""
    config = load((", x_hat: [0.065, 0.085]", ""))
    assert [warning.path for warning in config.warnings] == ["initial"]
    assert "x = 0.0647089, 0.0821864" in config.warnings[0].message
    assert load().warnings == ()


def test_a_nonlinear_model_with_an_operating_point_serves_linear_methods(load):
    """Oracle: the gains of `linearise`."""
    found = load(("linearise: plant", "nonlinear: plant")).experiment.methods[0]
    expected = load().experiment.methods[0]
    np.testing.assert_array_equal(found.controller.K_x, expected.controller.K_x)
    np.testing.assert_array_equal(found.controller.u_op, expected.controller.u_op)
    np.testing.assert_array_equal(found.estimator.f, expected.estimator.f)


@pytest.mark.long
def test_check_prints_the_operating_point(load):
    """With residual, eigenvalues, poles and ranks; --deep builds the model once more."""
    path = load().path
    result = CliRunner().invoke(check, [str(path), "--deep", "--full"])
    assert result.exit_code == 0, result.output
    for label in ("operating point", "steady state with residual", "eigenvalues", "sampled poles", "observable"):
        assert label in " ".join(result.output.split())


def test_the_resolved_configuration_is_the_same(load):
    """With all defaults it has the same keys."""
    from rmpc_bench.config_file.yaml import dump

    config = load()
    again = config.path.with_name("again.yaml")
    again.write_text(dump(config.resolved), encoding="utf-8")
    assert load_config(again).points[0].method_keys == config.points[0].method_keys


CONSTANT = '''
import numpy as np
from rmpc_bench import single_run


@single_run
class Largest:
    """Apply the upper limit of the input."""

    def __init__(self, limits):
        self.high = float(limits.u[1][0])

    def control(self, x_hat, r):
        return np.array([self.high])
'''


def test_points_with_other_bounds_share_no_controller_that_takes_them(load, tmp_path):
    """Each point of a sweep has the limits of its own plant, also where no model is made from it."""
    (tmp_path / "largest.py").write_text(CONSTANT, encoding="utf-8")
    model = "model: {kind: linear, A: [[0.9, 0], [0.1, 0.9]], B: [[0.001], [0]], C: [[0, 1]], P_w: 1.0e-6, P_v: 4.0e-6}"
    controller = "controller: {kind: mpc, Hp: 20, Hu: 3, Q: 1, R: 1.0e-6, limits: {u: [0, 30]}}"
    sweep = "controller: {file: largest.py:Largest}\nsweep: {grid: {plant.bounds.pump: [[0, 30], [0, 5]]}}"
    config = load((MODEL, model), (controller, sweep))
    designs = [point.experiment.methods[0].controller for point in config.points]
    assert [float(design.given["plant_info"].limits.u[1][0]) for design in designs] == [30.0, 5.0]


def test_points_with_other_starts_share_no_model_of_the_plant(load):
    """The plant of a differential equation is made with its initial state, which a design may use."""
    sweep = "metrics: [mse]\nsweep: {grid: {initial.x: [[0.06, 0.08], [0.07, 0.08]]}}"
    first, second = (point.experiment.methods[0] for point in load(("metrics: [mse]", sweep)).points)
    assert first.estimator is not second.estimator and first.controller is not second.controller
