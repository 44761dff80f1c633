"""Noise as spectral density: the covariance of a sample by Van Loan's exponential, in models and laws of the plant."""

import numpy as np
import pytest
from conftest import ROUND
from scipy.integrate import quad_vec
from scipy.linalg import expm

from rmpc_bench import load_config
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.types import ConfigError

CODE = """
import numpy as np
from scipy.signal import lti

def rhs(x, u, p): return [x[1], -0.5 * x[1] + u[0]]
def decay(x, u, p): return [-x[0] + u[0]]
def double(x, u, p): return [x[1], u[0]]
def bent(x, u, p): return [x[1], -0.5 * x[1] - x[0] ** 3 + u[0]]
def first(x, p): return [x[0]]
system = lti(np.array([[0, 1], [0, -0.5]]), np.array([[0], [1.0]]), np.array([[1.0, 0]]), np.array([[0.0]]))
"""
TEXT = """
version: 1
name: density
runs: 3
time: {{step: {step}, steps: 5}}
plant: {plant}
model: {model}
noise: {noise}
initial: {initial}
methods: {{KF: {{estimator: {{kind: {estimator}}}}}}}
input: {{kind: sine, amplitude: 1, period: 5}}
metrics: [estimation_mse]
"""
EXACT_POINT = "at: {x: 0, u: 0}, "
NOISE = "noise: {process: {density: [0, 0.2]}, measurement: {density: 0.01}}"
ODE = "{ode: own.py:rhs, output: own.py:first, states: [a, b], inputs: [f], outputs: [h]}"
Q = np.array([[6.4223973517e-5, 9.5142761381e-4], [9.5142761381e-4, 0.019032516393]])
CASES = {
    "linearise": (ODE, f"{{linearise: plant, {EXACT_POINT}{NOISE}}}"),
    "nonlinear": (ODE, f"{{nonlinear: plant, {EXACT_POINT}{NOISE}}}"),
    "ode": (ODE, f"{{ode: own.py:rhs, output: own.py:first, {EXACT_POINT}{NOISE}}}"),
    "scipy": ("{scipy: own.py:system}", f"{{scipy: own.py:system, {NOISE}}}"),
    "linearise a scipy plant": ("{scipy: own.py:system}", f"{{linearise: plant, {EXACT_POINT}{NOISE}}}"),
    "nonlinear of a scipy plant": ("{scipy: own.py:system}", f"{{nonlinear: plant, {NOISE}}}"),
}


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the configuration with other values."""
    (tmp_path / "own.py").write_text(CODE, encoding="utf-8")

    def loaded(plant=ODE, model=CASES["linearise"][1], *, step=0.1, noise="none", initial="{x: 0}", **keys):
        text = TEXT.format(plant=plant, model=model, step=step, noise=noise, initial=initial,
                           estimator=keys.pop("estimator", "extended-kalman"))  # fmt: skip
        text += "".join(f"{key}: {value}\n" for key, value in keys.items())
        (tmp_path / "case.yaml").write_text(text, encoding="utf-8")
        return load_config(tmp_path / "case.yaml")

    return loaded


def of(config, point=0):
    """Q_w and R_v of the design model at a point."""
    flow = config.points[point].experiment.methods[0].estimator.flow
    model = getattr(flow, "model", flow)
    return model.Q_w, model.R_v


def problems(load, *arguments, **keys):
    """Messages of a configuration with errors."""
    with pytest.raises(ConfigError) as caught:
        load(*arguments, **keys)
    return [str(each) for each in caught.value.problems]


@pytest.mark.parametrize("case", CASES)
def test_the_covariance_of_a_sample(load, case):
    """Oracle: the values of the closed form; R_v is the density over the sampling time."""
    Q_w, R_v = of(load(*CASES[case]))
    np.testing.assert_allclose(Q_w, Q, rtol=1e-9)  # digits of the values
    np.testing.assert_allclose(R_v, [[0.1]], **ROUND)


@pytest.mark.parametrize(
    ("rhs", "density", "step", "expected"),
    [
        ("decay", "2", 0.1, [[0.181269246922]]),
        ("double", "[0, 0.3]", 0.5, [[0.0125, 0.0375], [0.0375, 0.15]]),
    ],
)
def test_further_values_in_closed_form(load, rhs, density, step, expected):
    """Oracle: 1 - e^(-2 Ts), and q Ts^3 / 3, q Ts^2 / 2, q Ts."""
    names = "states: [a], inputs: [f]" if rhs == "decay" else "states: [a, b], inputs: [f]"
    model = f"{{linearise: plant, {EXACT_POINT}noise: {{process: {{density: {density}}}, measurement: 1}}}}"
    Q_w, R_v = of(load(f"{{ode: own.py:{rhs}, {names}}}", model, step=step))
    np.testing.assert_allclose(Q_w, expected, rtol=1e-11)  # digits of the values
    np.testing.assert_array_equal(R_v, np.eye(len(Q_w)))


def test_two_halves_of_a_sample_are_one(load):
    """Oracle: Q(Ts) = A Q A' + Q of Ts / 2, and R_v / 2; and the integral by quadrature."""
    (one, R), (half, R_half) = of(load()), of(load(step=0.05))
    A = np.array([[0.0, 1.0], [0.0, -0.5]])
    np.testing.assert_allclose(expm(0.05 * A) @ half @ expm(0.05 * A).T + half, one, **ROUND)
    np.testing.assert_allclose(R_half, 2 * R, **ROUND)
    integral = quad_vec(lambda s: expm(s * A) @ np.diag([0.0, 0.2]) @ expm(s * A).T, 0.0, 0.1, epsabs=1e-16)[0]
    np.testing.assert_allclose(one, integral, rtol=1e-10)  # of the quadrature


@pytest.mark.parametrize("case", ["linearise", "scipy"])
def test_a_law_of_the_plant(load, case):
    """Oracle: the covariances of `same` of a model with these densities; the written file loads as the same."""
    noise = "{process: {gaussian: {density: [0, 0.2]}}, measurement: {gaussian: {density: 0.01}}}"
    config, same = load(*CASES[case], noise=noise), load(*CASES[case], noise="same")
    laws = [each.experiment.scenario.noise_laws(2, 1)[1] for each in (config, same)]
    np.testing.assert_allclose(laws[0], laws[1], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(laws[0][:2, :2], Q, rtol=1e-8)  # digits of the values
    config.path.with_name("copy.yaml").write_text(dump(plain(config.resolved)), encoding="utf-8")
    assert load_config(config.path.with_name("copy.yaml")).hash == config.hash


def test_without_an_operating_point(load):
    """Oracle: Q_w = Ts Q_c, and the share by hand; where the equation is bent it depends on x_hat."""
    model = f"{{nonlinear: plant, {NOISE}}}"
    config = load(ODE, model)
    np.testing.assert_allclose(of(config)[0], np.diag([0.0, 0.02]), **ROUND)
    [warning] = [str(each) for each in config.warnings]
    # The variance of a is wholly neglected.
    assert "model.noise.process: without an operating point Q_w = Ts Q_c" in warning and "up to 100 % off" in warning
    bent = ODE.replace("rhs", "bent")
    noise = "{process: {gaussian: {density: [0.2, 0.1]}}}"
    said = [load(bent, model.replace("[0, 0.2]", "[0.2, 0.1]"), initial=f"{{x_hat: [{x}, 0], P: 1}}").warnings
            for x in (0, 3)]  # fmt: skip
    assert said[0] != said[1]
    config = load(bent, f"{{nonlinear: plant, {NOISE}}}", noise=noise)
    assert any(": noise.process: without an operating point" in str(each) for each in config.warnings)
    cov = config.experiment.scenario.noise_laws(2, 1)[1]
    np.testing.assert_allclose(cov[:2, :2], np.diag([0.02, 0.01]), **ROUND)


def test_what_is_refused(load):
    """Oracle: one mistake each, at its place."""
    discrete = "{kind: linear, A: [[0.9, 0.1], [0, 0.8]], B: [[0], [1]], C: [[1, 0]]}"
    [found] = problems(load, discrete, f"{{nonlinear: plant, {NOISE}}}")
    assert "model.noise.process.density: density needs a continuous model" in found
    plain_noise = "noise: {process: 1, measurement: 1}"
    for channel in ("process", "measurement"):
        noise = f"{{{channel}: {{gaussian: {{density: 1}}}}}}"
        [found] = problems(load, discrete, f"{{nonlinear: plant, {plain_noise}}}", noise=noise)
        assert f"noise.{channel}.gaussian.density: density needs a continuous plant" in found
    [found] = problems(load, noise="{process: {gaussian: {density: 1, std: 1}}}")
    assert "noise.process.gaussian.density: give one of std, cov and density" in found
    [found] = problems(load, initial="{x: {gaussian: {density: 1}}}")
    assert "initial.x.gaussian.density: an initial state is a single sample" in found
    [found] = problems(load, ODE, CASES["linearise"][1].replace("[0, 0.2]", "-1"))
    assert "noise.process.density: must be positive semidefinite" in found
    law = "{process: {gaussian: {density: [0, 1]}}}"
    [found] = problems(load, ODE, CASES["linearise"][1].replace("x: 0", "x: [0, 0, 0]"), noise=law)
    assert "model.at.x: has 3 entries" in found


def test_a_sweep_over_the_sampling_time(load):
    """Oracle: the remark is said of a covariance per sample, and not of a density, which follows the step."""
    sweep = "{grid: {time.step: [0.1, 0.05]}}"
    followed = load(sweep=sweep)
    assert not followed.warnings
    Q_w = [of(followed, point)[0] for point in range(2)]
    np.testing.assert_allclose(Q_w[0], Q, rtol=1e-9)  # digits of the values
    np.testing.assert_allclose(Q_w[1][1, 1], -0.2 * np.expm1(-0.05), **ROUND)
    model = CASES["linearise"][1].replace("{density: [0, 0.2]}", "[1e-6, 0.02]")
    [warning] = [str(each) for each in load(ODE, model, sweep=sweep).warnings]
    assert "model.noise.process: P_w stays at every step; `density` follows it" in warning
    assert not load(ODE, model).warnings
