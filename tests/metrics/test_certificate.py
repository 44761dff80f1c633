"""The metric that evaluates the certificate of a controller."""

import numpy as np
import pytest
from metrics.estimate_records import LAYOUT, N, plant, trajectories
from metrics.issue_checks import no_issue, only_issue
from simulation.toy import Halfway, Proportional

from rmpc_bench.metrics.certificate import Certificate
from rmpc_bench.types import Method


class Certifies(Proportional):
    """A controller whose bound depends on the arguments; it records them."""

    def __init__(self):
        super().__init__()
        self.calls = []

    certifies = True

    def certificate(self, k, x_hat, starts):
        """Certify the square of x_hat; the worst is the sample times as much, and starts more."""
        self.calls.append((k, x_hat.copy(), starts))
        rho = x_hat[:, 0] ** 2
        return rho, k * rho + starts


class Exact(Proportional):
    """A controller of a loop without noise."""

    certifies = True

    def certificate(self, k, x_hat, starts):
        """Nothing is added."""
        return np.zeros(len(x_hat)), np.zeros(len(x_hat))


@pytest.mark.parametrize(
    ("of", "value"), [("rho", lambda rho: rho), ("worst", lambda rho: 3 * rho + 7), ("excess", lambda rho: 3 + 7 / rho)]
)
def test_the_values_are_those_of_the_controller(of, value, rng):
    """Oracle: the toy's own numbers, of x_hat at the sample (1.5 s are three) and the number of starts."""
    controller, block = Certifies(), trajectories(rng)
    found = Certificate(of=of, at=1.5, starts=7).evaluate(block._replace(controller=controller))
    np.testing.assert_allclose(found, value(block.x_hat[:, 3, 0] ** 2), rtol=1e-15)
    ((k, x_hat, starts),) = controller.calls
    assert (k, starts) == (3, 7)
    np.testing.assert_array_equal(x_hat, block.x_hat[:, 3])


def test_noise_in_one_set_is_asked_of_the_controller(rng):
    """Oracle: the toy halves the worst cost then."""

    class Halves(Certifies):
        def certificate(self, k, x_hat, starts, *, shared=False):
            rho, worst = super().certificate(k, x_hat, starts)
            return rho, worst / 2 if shared else worst

    block = trajectories(rng)._replace(controller=Halves())
    each, shared = (Certificate(of="worst", at=1.5, noise=noise).evaluate(block) for noise in ("each", "shared"))
    np.testing.assert_array_equal(shared, each / 2)


def test_a_bound_of_zero_that_holds_is_tight(rng):
    """Oracle: 0/0 is 1 here."""
    values = Certificate(at=0.0).evaluate(trajectories(rng)._replace(controller=Exact()))
    np.testing.assert_array_equal(values, np.ones(4))


def test_a_run_without_an_estimate_has_no_value(rng):
    """Oracle: the others have the values that they have alone; where all have failed, the controller is not called."""
    controller, block = Certifies(), trajectories(rng)
    block.x_hat[1, 2:] = np.nan
    metric = Certificate(at=1.0)
    values = metric.evaluate(block._replace(controller=controller))
    assert np.isnan(values[1]) and len(controller.calls[0][1]) == 3
    for i in (0, 2, 3):
        alone = block._replace(x_hat=block.x_hat[i : i + 1], controller=controller)
        np.testing.assert_array_equal(metric.evaluate(alone), values[i : i + 1])
    block.x_hat[:] = np.inf
    controller.calls.clear()
    assert np.isnan(metric.evaluate(block._replace(controller=controller))).all() and controller.calls == []


def test_a_controller_without_a_certificate_is_refused(rng):
    """Oracle: refused before any run where methods are known, else no run has a value."""
    methods = tuple(Method(name, Halfway(), law) for name, law in (("A", Certifies()), ("B", Proportional())))
    layout = LAYOUT._replace(plant=plant(1), methods=methods)
    message = "depend on the data, which 'B' does not have; leave the metric or the method"
    only_issue(Certificate(at=0.0), layout, "", message)
    no_issue(Certificate(at=0.0), layout._replace(methods=methods[:1]))
    assert np.isnan(Certificate(at=0.0).evaluate(trajectories(rng))).all()


def test_its_column():
    """Oracle: the quotient is best at 1; a smaller cost is better; there is no input at k = N."""
    infos = {of: Certificate(of=of, at=0.0).info(LAYOUT) for of in ("excess", "rho", "worst")}
    assert {of: info.direction for of, info in infos.items()} == {"excess": "one", "rho": "lower", "worst": "lower"}
    assert Certificate(at=(N - 1) * 0.5, name="mine").window(LAYOUT) == (N - 1, N - 1)
    only_issue(Certificate(at=N * 0.5), LAYOUT, "at", f"sample {N} lies beyond the last one with an input, {N - 1}")
    assert Certificate(at=100.0).window(LAYOUT._replace(cut=True)) == (N - 1, N - 1)
