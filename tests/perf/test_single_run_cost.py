"""Cost of components written for one run beyond the user's own calls; nothing here asserts a time.

The budget is 5 us per run and step.
"""

import numpy as np
import pytest
from components.one_run import Fixed, Textbook, designed, single_run

from rmpc_bench.types import as_estimate

pytestmark = pytest.mark.perf

RUNS, STEPS = 50, 200
Y, U = np.ones((RUNS, 1)), np.ones((RUNS, 1))


@single_run
class Nothing(Fixed):
    """An estimator that costs nothing: what is measured is the adapter."""

    def update(self, y, u_previous):
        """Return the first estimate."""
        return self.x


@single_run
class NoLaw:
    """A controller that costs nothing."""

    def control(self, x_hat, r, u_previous):
        """Return the first state."""
        return x_hat[:1]


def estimates(cls):
    """Return a function that runs an estimator over a block."""
    design = designed("estimators", cls)

    def run():
        state = design.init(RUNS)
        for k in range(STEPS):
            state, _ = design.correct(k, state, Y)
            state = design.predict(k, state, U)

    return run


def test_adapter_of_an_estimator(benchmark):
    """50 runs x 200 steps; divided by 10,000 it is the cost per run and step."""
    benchmark(estimates(Nothing))


def test_adapter_of_a_controller(benchmark):
    """The same for a controller."""
    design, estimate, r = designed("controllers", NoLaw), as_estimate(np.ones((RUNS, 2))), np.ones((1, 1))

    def run():
        state = design.init(RUNS)
        for k in range(STEPS):
            state, _ = design.control(k, state, Y, estimate, r)

    benchmark(run)


def test_textbook_filter(benchmark):
    """A textbook Kalman filter in NumPy, adapter included."""
    benchmark.pedantic(estimates(Textbook), rounds=3)
