"""Wrong configurations of a first-time user: an error or a warning names the key, its place and the way out."""

import pytest
from small_experiment import cli, ran, text, write

from rmpc_bench import load_config
from rmpc_bench.types import ConfigError

A, B, C = "[[1, 0.1], [0, 0.9]]", "[[0], [0.1]]", "[[1, 0]]"


OWN = f"{{kind: linear, A: {A}, B: {B}, C: {C}, P_w: 0.01, P_v: 0.1}}"


def linear(A=A, B=B, C=C, model="P_w: 0.01, P_v: 0.1", **keys):
    """Return the small experiment with a linear plant of two states."""
    return {
        "uncertainty": None,
        "plant": f"{{kind: linear, A: {A}, B: {B}, C: {C}}}",
        "model": None if model is None else f"{{from: plant, {model}}}",
        "noise": "{process: {gaussian: {std: 0.1}}, measurement: {gaussian: {std: 0.3}}}",
        "initial": "{x: 0, x_hat: 0, P: 1}",
        "reference": None,
        "controller": "{kind: lqr, horizon: 10, Q_x: 1, R_u: 1}",
        "methods": "{K: {estimator: {kind: kalman}}}",
        "metrics": "[{kind: mse, of: state}]",
        **keys,
    }


def servo(**keys):
    """Return changes of the small experiment, whose plant is the servomechanism."""
    return keys


ERRORS = {
    "a flat output matrix": (
        linear(C="[1, 0]"), "plant.C", "[1, 0]",
        "[[1, 0]] is 1 x 2 (1 output, 2 states), [[1], [0]] is 2 x 1 (2 outputs, 1 state); the other matrices fit "
        "[[1, 0]]",
    ),
    "an input matrix in the wrong orientation": (
        linear(B="[[0, 0.1]]"), "plant.B", "[[0, 0.1]]",
        "has the shape 1 x 2; 2 x nu fits the other matrices (nx = 2), which its transpose has: [[0], [0.1]]",
    ),
    "a flat cross-covariance": (
        linear(noise="{process: same, measurement: same, cross: [0.1, 0]}"), "noise.cross", "[0.1",
        "write it row by row: [[0.1, 0]] is 1 x 2, [[0.1], [0]] is 2 x 1",
    ),
    "a cross-covariance in the wrong orientation": (
        linear(noise="{process: same, measurement: same, cross: [[0.1, 0]]}"), "noise.cross", "[[0.1",
        "shape (1, 2) does not fit: 2 x 1 numbers are required, as in its transpose",
    ),
    "a metric in the wrong case": (
        servo(metrics="[mse, NEES]"), "metrics.1", "NEES", "did you mean 'nees'? (rmpc-bench list metrics)",
    ),
    "a range under perturb": (
        servo(plant="{kind: servo-linear, perturb: {R: +-10%}}"), "plant.perturb.R", "+-10%",
        "write the range under `uncertainty`, {eps: +-10%}, and R: 1 + eps here",
    ),
    "a filter without noise": (
        servo(model="{kind: servo-linear, noise: {process: 0, measurement: 0}}",
              methods="{S: {estimator: {kind: kalman}}}"),
        "methods.S.estimator", "{kind: kalman}", "the model needs measurement noise",
    ),
    "a filter that knows the state after two samples": (
        linear(model="P_w: 0, P_v: 0"), "methods.K.estimator", "{kind: kalman}", "the model needs measurement noise",
    ),
    "the name x0": (servo(initial="{x0: [1, 0, 0, 0]}"), "initial.x0", "x0", "did you mean 'x'?"),
    "Hu beyond Hp": (
        servo(controller="{kind: mpc, Hp: 3, Hu: 10, Q: 0.1, R: 0.1}"), "controller.Hu", "10",
        "must be at most Hp = 3 (got 10)",
    ),
    "a negative variance": (
        servo(noise="{measurement: {gaussian: {cov: -1}}}"), "noise.measurement.gaussian.cov", "-1",
        "must be positive semidefinite (smallest eigenvalue -1)",
    ),
    "both std and cov": (
        servo(noise="{measurement: {gaussian: {std: 1, cov: 1}}}"), "noise.measurement.gaussian", "{std",
        "give one of std, cov and density",
    ),
    "a perturbed entry of a matrix": (
        linear(uncertainty="{eps: +-10%}", plant=f"{{kind: linear, A: {A}, B: {B}, C: {C}, set: {{k: 1 + eps}}}}"),
        "plant.set.k", "k", "linear has no named parameters; an uncertain entry of A is written with the kind "
        "uncertain-linear (H_A, G_x), or take an `ode` with `perturb`",
    ),
    "an uncertain quantity in a matrix": (
        linear(uncertainty="{eps: +-10%}", A="[[1, 0.1], [0, 0.9*(1 + eps)]]"), "plant.A", "[[1, 0.1]",
        "column 10 of '0.9*(1 + eps)': 'eps' is an uncertain quantity, and this value is a fixed number; it stands in "
        "`plant.perturb` and `plant.set`, and an uncertain entry of A is written with the kind uncertain-linear (H_A",
    ),
    "an uncertain quantity in a design": (
        servo(methods="{R: {estimator: {kind: robust-kalman, c: 1 + eps}}}"), "methods.R.estimator.c", "1 + eps",
        "column 5 of '1 + eps': 'eps' is an uncertain quantity, and this value is a fixed number",
    ),
    "sigma": (
        servo(noise="{measurement: {gaussian: {sigma: 1}}}"), "noise.measurement.gaussian.sigma", "sigma",
        "did you mean 'std'?",
    ),
    "another name of the normal law": (
        servo(noise="{measurement: {normal: {std: 1}}}"), "noise.measurement", "{normal", "did you mean 'gaussian'?",
    ),
    "a number as noise": (
        servo(noise="{measurement: 0.01}"), "noise.measurement", "0.01", "write {gaussian: {std: 0.01}}, or cov",
    ),
    "a symbol as channel": (
        servo(noise="{v: {gaussian: {std: 1}}}"), "noise.v", "v", "did you mean 'measurement'?",
    ),
    "a law without channel": (
        servo(noise="{gaussian: {std: 1}}"), "noise.gaussian", "gaussian", "a law is given per channel: {process: ",
    ),
    "a list for one number": (
        servo(methods="{R: {estimator: {kind: robust-kalman, c: [0.1, 1]}}}"), "methods.R.estimator.c", "[0.1, 1]",
        "must be one value (got [0.1, 1]); several values are compared by `sweep`",
    ),
    "samples in a window of seconds": (
        servo(time="{step: 0.1, duration: 20}", metrics="[{kind: mse, from: 100}]"), "metrics.0", "{kind",
        "the window from 1000 to 199 (samples) must lie in 0..200 and contain at least one sample; from and to are in "
        "seconds, and the experiment lasts 20 s",
    ),
    "a matrix of standard deviations": (
        linear(noise="{process: {gaussian: {std: [[0.1, 0], 0.1]}}}"), "noise.process.gaussian.std.0", "[0.1, 0]",
        "must be one number, not a list (got [0.1, 0])",
    ),
    "the noise of a common model where each method has its own": (
        linear(model=None, methods=f"{{K: {{estimator: {{kind: kalman}}, model: {OWN}}}}}", noise="same"),
        "noise", "same", "'same' is the law of the common design model: 'model' is missing",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", ERRORS)
def test_a_mistake_is_an_error_with_key_place_and_way_out(tmp_path, mistake):
    """Oracle: by hand."""
    keys, path, shown, message = ERRORS[mistake]
    file = write(tmp_path, **keys)
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    (problem,) = caught.value.problems
    assert problem.path == path and message in problem.message
    line = text(**keys).splitlines()[problem.line - 1]
    assert line.startswith(path.partition(".")[0]) and line[problem.column - 1 :].startswith(shown)


def test_a_common_model_is_not_needed_where_each_method_has_its_own(tmp_path):
    """The same numbers as with it, also from the resolved configuration."""
    methods = f"{{K: {{estimator: {{kind: kalman}}, model: {OWN}}}}}"
    tables = [
        ran(write(tmp_path, **linear(model=model, methods=methods)), tmp_path / name)
        for name, model in (("with", "P_w: 0.01, P_v: 0.1"), ("without", None))
    ]
    tables.append(ran(tmp_path / "without" / "config.resolved.yaml", tmp_path / "again"))
    assert len({*tables}) == 1
    with pytest.raises(ConfigError, match="'model' is missing"):
        load_config(write(tmp_path, **linear(model=None)))


WARNINGS = {
    "degrees": (
        servo(reference="{kind: constant, value: 90}"), "reference",
        "reaches 90 rad, 14.3 turns; angles are in radians: 90 degrees are written 90*pi/180",
    ),
    "an absolute value under perturb": (
        servo(plant="{kind: servo-linear, perturb: {R: 20}}"), "plant.perturb.R",
        "multiplies the nominal value 20 by 20, which gives 400; an absolute value is written plant.set: {R: 20}",
    ),
    "an uncertain quantity without its 1": (
        servo(plant="{kind: servo-linear, perturb: {J_l: eps}}"), "plant.perturb.J_l",
        "by 0 at the median of eps; a factor around 1 is written 1 + eps",
    ),
    "no sampling time": (servo(time="{duration: 20}"), "time", "the sampling time is 1; give it, such as"),
    "seconds in a window of samples": (
        servo(time="{step: 0.1, steps: 20}", metrics="[{kind: mse, from: 0.6}]"), "metrics.0.from",
        "0.6 is between the samples 0 and 1, because `time` is given in steps; for seconds give time.duration",
    ),
    "a model without noise": (
        linear(model="P_w: 0, P_v: 0", methods="{K: {estimator: {kind: kalman-predictor}}}"), "model",
        "has neither process nor measurement noise",
    ),
    "an initial covariance beyond fourteen decades": (
        linear(model="P_w: 0.01, P_v: 0.01", initial="{P: 1e14}"), "model",
        "the variance of a measurement due to `initial.P` is 1e+16 times that of its noise; beyond 1e+14",
    ),
    "a covariance taken for a scale": (
        linear(model="P_w: 0.01, P_v: 0.01", noise="{process: same, measurement: {same: {dof: 3}}}",
               methods="{K: {estimator: {kind: student-kalman, dof: 3}}}"), "model",
        "the covariance of the noise (t with dof = 3); method K takes it for the scale matrix: give its estimator",
    ),
    "a model without measurement noise": (
        linear(model="P_w: 0.01"), "model", "has no measurement noise, but the plant has: a filter fits every "
        "measurement; give P_v",
    ),
    "a model without process noise": (
        linear(model="P_v: 0.01"), "model", "has no process noise, but the plant has: the gain of a filter tends to 0; "
        "give P_w",
    ),
    "a measurement noise that is forgotten": (
        linear(noise="{process: same, measurement: {sum: [{delayed: 1}, {missing: {probability: 8%}}]}}"),
        "noise.measurement", "has only laws that change y (delayed, missing); it adds no noise, although the design "
        "model has one: {sum: [same, ..]}",
    ),
    "an unstable mode that is not measured": (
        linear(model="A: [[0.9, 0], [0, 1.3]], P_w: 1, P_v: 1"), "model",
        "has an unobservable unstable mode (|z| = 1.3); no estimator is stable: see A and C",
    ),
    "an unstable mode that is not actuated": (
        linear(model="A: [[1.3, 0], [0, 0.9]], P_w: 1, P_v: 1"), "model",
        "has an uncontrollable unstable mode (|z| = 1.3); no controller is stabilising: see A and B",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", WARNINGS)
def test_a_doubtful_configuration_gets_one_warning_with_key_place_and_way_out(tmp_path, mistake):
    """Oracle: by hand."""
    keys, path, message = WARNINGS[mistake]
    file = write(tmp_path, **keys)
    (warning,) = load_config(file).warnings
    assert warning.path == path and message in warning.message
    assert text(**keys).splitlines()[warning.line - 1].startswith(path.partition(".")[0])


@pytest.mark.parametrize(
    ("keys", "law"), [("R_v: covariance", "{same: {dof: 3}}"), ("dof: 3", "{student-t: {dof: 3, scale: 0.1}}")]
)
def test_a_scale_matrix_taken_as_such_gets_no_warning(tmp_path, keys, law):
    """The model has R_v = 0.01: as covariance, or as the scale matrix of the noise."""
    methods = f"{{K: {{estimator: {{kind: student-kalman, {keys}}}}}}}"
    noise = f"{{process: same, measurement: {law}}}"
    assert not load_config(
        write(tmp_path, **linear(model="P_w: 0.01, P_v: 0.01", noise=noise, methods=methods))
    ).warnings


def test_check_and_run_show_a_warning_in_one_line(tmp_path):
    """Oracle: the same line; `run` writes it to stderr, since it is no result."""
    path = write(tmp_path, reference="{kind: constant, value: 90}")
    (warning,) = load_config(path).warnings
    assert f"-warning:{warning}".replace(" ", "") in "".join(cli("check", path).stdout.split())
    result = cli("run", path, "-o", tmp_path / "out", "--smoke", "--dry-run", "--progress", "none")
    assert f"warning: {warning}\n" in result.stderr and str(warning) not in result.stdout


@pytest.mark.parametrize("keys", [servo(), linear(), servo(reference="{kind: constant, value: 2*pi}")])
def test_a_sound_configuration_has_no_warning(tmp_path, keys):
    """Oracle: an integrator, a factor around 1 and an angle of one turn are usual."""
    assert load_config(write(tmp_path, **keys)).warnings == ()


def test_points_of_a_sweep_share_a_warning(tmp_path):
    """Oracle: one line for three points."""
    path = write(tmp_path, reference="{kind: constant, value: 90}", sweep="{grid: {controller.Hp: [10, 11, 12]}}")
    assert len(load_config(path).warnings) == 1
