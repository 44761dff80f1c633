"""Systems of scipy.signal as plants and models."""

import numpy as np
import pytest
from adapters.scipy_systems import oscillator, trajectory
from conftest import ROUND
from scipy import signal

from rmpc_bench.adapters.scipy_signal import model, plant
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.plants.linear import ParametricLinear
from rmpc_bench.plants.linear import design as linear
from rmpc_bench.plants.uncertain_linear import UncertainLinear
from rmpc_bench.types import DesignError

NOISE = DesignNoise(1e-3, 1e-2)


@pytest.mark.parametrize(
    "given",
    [
        signal.lti([2.0], [1.0, 0.6, 1.0]),
        signal.ZerosPolesGain([], [-1.0, -2.0], 2.0),
        signal.StateSpace([[0.0, 1.0], [-1.0, -0.6]], [[0.0], [2.0]], [[1.0, 0.0]], [[0.0]]),
    ],
)
def test_the_step_response_is_that_of_scipy(given):
    """Oracle: `dstep` of `to_discrete` with a zero-order hold."""
    bench, steps = plant(0.1, 40, scipy=given), 40
    assert isinstance(bench, UncertainLinear) and bench.names == {}
    _, (expected,) = signal.dstep(given.to_ss().to_discrete(0.1), n=steps)
    np.testing.assert_allclose(trajectory(bench, np.ones((steps, 1))), expected, rtol=1e-10, atol=1e-13)


def test_a_discrete_system_is_used_as_it_is():
    """Oracle: the plant `linear`, bit for bit."""
    A, B, C = [[0.9, 0.1], [0.0, 0.8]], [[0.0], [1.0]], [[1.0, 0.5]]
    u = np.random.default_rng(2).standard_normal((30, 1))
    for dt in ({"dt": 0.1}, {"dt": True}):
        bench = plant(0.1, 30, scipy=signal.dlti(A, B, C, [[0.0]], **dt))
        np.testing.assert_array_equal(trajectory(bench, u), trajectory(linear(0.1, 30, A=A, B=B, C=C), u))
    with pytest.raises(DesignError, match=r"sampling time 0.1, and time.step is 0.2"):
        plant(0.2, 30, scipy=signal.dlti(A, B, C, [[0.0]], dt=0.1))


def test_parameters_of_a_run():
    """Oracle: scipy's own discretisation, run by run; equal runs have equal matrices."""
    bench = plant(0.1, 10, scipy=oscillator, parameters={"m": 2.0})
    assert isinstance(bench, ParametricLinear) and bench.nominal == {"m": 2.0, "k": 2.0, "d": 0.3}
    k = np.array([1.0, 3.0, 1.0])
    delta = bench.draw({"m": np.full(3, 2.0), "k": k, "d": np.full(3, 0.3)}, [], 10)
    for i in range(3):
        exact = oscillator(2.0, k[i]).to_discrete(0.1)
        np.testing.assert_allclose(delta.A[i], exact.A, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(delta.B[i], exact.B, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(delta.A[0], delta.A[2])
    made = model(0.1, scipy=oscillator, noise=NOISE)
    np.testing.assert_allclose(made.A, oscillator().to_discrete(0.1).A, **ROUND)
    np.testing.assert_array_equal(made.R_v, [[1e-2]])


def test_the_naive_plant_with_a_discretisation_of_euler_is_off():
    """The sampled system is exact, for a step as long as the time constant as well."""
    system, Ts, steps = oscillator(), 1.0, 10
    exact = signal.lsim(system, np.ones(1001), np.linspace(0.0, 10.0, 1001))[1][::100][:steps]
    naive = linear(Ts, steps, A=(np.eye(2) + Ts * system.A).tolist(), B=(Ts * system.B).tolist(), C=system.C.tolist())
    u = np.ones((steps, 1))
    assert np.abs(trajectory(naive, u)[:, 0] - exact).max() > 1.0
    np.testing.assert_allclose(trajectory(plant(Ts, steps, scipy=system), u)[:, 0], exact, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda: 3.0, "must be an lti or a dlti of scipy.signal"),
        (lambda m: oscillator(m), "takes m, which has no value"),
        (lambda m=np.nan: oscillator(m), "has a matrix that is not finite"),
    ],
)
def test_mistakes(given, message):
    """Every one is a design error at the key `scipy`."""
    with pytest.raises(DesignError, match=message) as caught:
        plant(0.1, 10, scipy=given)
    assert caught.value.parameter == "scipy"
