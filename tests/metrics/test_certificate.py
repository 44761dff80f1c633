"""The metric that asks a controller for its certificate."""

import numpy as np
import pytest
from metrics.test_metrics_of_estimates import UNITS, N, plant, trajectories
from simulation.toy import Halfway, Proportional

from rmpc_bench.metrics.certificate import certificate
from rmpc_bench.types import DesignError, Method


class Certifies(Proportional):
    """A controller whose bound depends on what it is asked; it remembers that."""

    def __init__(self):
        super().__init__()
        self.asked = []

    certifies = True

    def certificate(self, k, x_hat, starts):
        """Certify the square of x_hat; the worst is the sample times as much, and starts more."""
        self.asked.append((k, x_hat.copy(), starts))
        rho = x_hat[:, 0] ** 2
        return rho, k * rho + starts


class Exact(Proportional):
    """A controller that knows of no noise."""

    certifies = True

    def certificate(self, k, x_hat, starts):
        """Nothing is added."""
        return np.zeros(len(x_hat)), np.zeros(len(x_hat))


@pytest.mark.parametrize(
    ("of", "value"), [("rho", lambda rho: rho), ("worst", lambda rho: 3 * rho + 7), ("excess", lambda rho: 3 + 7 / rho)]
)
def test_what_the_controller_says_of_the_estimate(of, value, rng):
    """Oracle: the toy's own numbers, of x_hat at the sample (1.5 s are three samples) and as many starts as told."""
    controller, block = Certifies(), trajectories(rng)
    found = certificate(UNITS, of=of, at=1.5, starts=7).evaluate(block._replace(controller=controller))
    np.testing.assert_allclose(found, value(block.x_hat[:, 3, 0] ** 2), rtol=1e-15)
    ((k, x_hat, starts),) = controller.asked
    assert (k, starts) == (3, 7)
    np.testing.assert_array_equal(x_hat, block.x_hat[:, 3])


def test_a_bound_of_nothing_that_nothing_breaks_is_exact(rng):
    """Oracle: 0/0 is 1 here."""
    values = certificate(UNITS, at=0.0).evaluate(trajectories(rng)._replace(controller=Exact()))
    np.testing.assert_array_equal(values, np.ones(4))


def test_a_run_without_an_estimate_is_not_asked_about(rng):
    """Oracle: the others have the values that they have alone; where all have failed, nobody is asked."""
    controller, block = Certifies(), trajectories(rng)
    block.x_hat[1, 2:] = np.nan
    metric = certificate(UNITS, at=1.0)
    values = metric.evaluate(block._replace(controller=controller))
    assert np.isnan(values[1]) and len(controller.asked[0][1]) == 3
    for i in (0, 2, 3):
        alone = block._replace(x_hat=block.x_hat[i : i + 1], controller=controller)
        np.testing.assert_array_equal(metric.evaluate(alone), values[i : i + 1])
    block.x_hat[:] = np.inf
    controller.asked.clear()
    assert np.isnan(metric.evaluate(block._replace(controller=controller))).all() and controller.asked == []


def test_nobody_to_ask(rng):
    """Oracle: refused before any run where methods are known, else no run has a value."""
    methods = tuple(Method(name, Halfway(), law) for name, law in (("A", Certifies()), ("B", Proportional())))
    units = UNITS._replace(plant=plant(1), methods=methods)
    with pytest.raises(
        DesignError, match="depend on the data, which 'B' does not have; leave the metric or the method"
    ):
        certificate(units, at=0.0)
    certificate(units._replace(methods=methods[:1]), at=0.0)
    assert np.isnan(certificate(UNITS, at=0.0).evaluate(trajectories(rng))).all()


def test_what_it_is():
    """Oracle: the quotient is best at 1; a smaller cost is better; there is no input at k = N."""
    infos = {of: certificate(UNITS, of=of, at=0.0).info for of in ("excess", "rho", "worst")}
    assert {of: info.direction for of, info in infos.items()} == {"excess": "one", "rho": "lower", "worst": "lower"}
    assert certificate(UNITS, at=(N - 1) * 0.5, name="mine").window == (N - 1, N - 1)
    with pytest.raises(DesignError, match=f"sample {N} lies beyond the last one with an input, {N - 1}") as caught:
        certificate(UNITS, at=N * 0.5)
    assert caught.value.parameter == "at"
    assert certificate(UNITS._replace(cut=True), at=100.0).window == (N - 1, N - 1)
