"""One run of an experiment with inputs from outside, sample by sample.

The random inputs and the loop are those of `closed_loop.simulate`, so that a law that is applied here gives the
trajectory of the experiment, bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.simulation.closed_loop import Loop
from rmpc_bench.simulation.input_channel import least_delay
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.simulation.scenario import Experiment, own_draws
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Journal, Method, Status

_STATUSES = {int(status): status for status in Status}


class Sample(NamedTuple):
    """What is known at a sample k."""

    k: int
    y: Float[Array, " ny"]
    """What is measured, when it arrives; NaN where it is missing."""
    y_true: Float[Array, " ny"]
    """Output without measurement noise."""
    x: Float[Array, " nx"]
    """True state."""
    r: Float[Array, "preview ny"]
    """Reference from r(k) on."""
    x_hat: Float[Array, " nx_hat"] | None
    """Estimate, with the disturbances of the design model; None without an estimator."""
    status: Status
    message: str
    """Why the run has failed; empty where it has not, or where there is no description."""


class _NoEstimate(Estimator):
    """Takes the place of an estimator, where nothing is estimated."""

    def init(self, n_runs: int) -> None:
        """There is nothing to remember."""

    def correct(self, k: int, state: None, y: Array) -> tuple[None, Estimate]:
        """Return an estimate without coordinates."""
        return None, Estimate(np.zeros((len(y), 0)))

    def predict(self, k: int, state: None, u: Array) -> None:
        """There is nothing to predict."""


class Episode:
    """A run between its first and its last sample; the estimator of the method, if any, gives estimates.

    A run beyond those of the experiment has random inputs that no run of it has.  `preview` counts r(k).
    """

    def __init__(self, experiment: Experiment, run: int, method: Method | None = None, *, preview: int = 1) -> None:
        self.plant, self.n_steps, self.run = experiment.plant, experiment.n_steps, run
        self.method, self.preview, self.k = method, preview, 0
        scenario, runs = experiment.scenario, range(run, run + 1)
        draws = scenario.draw(self.plant, runs, self.n_steps)
        draws = own_draws(scenario, self.plant, runs, self.n_steps, draws)
        self.r = scenario.reference.sample(self.n_steps + 1 + preview)
        start, known = RunStart(scenario.seed, (run,), Journal()), self.r[: self.n_steps + 1]
        self.journal = start.journal
        used = method or Method("", _NoEstimate(), Rest(self.plant.nu))
        self._loop = Loop(self.plant, used, draws, known, self.n_steps, start, experiment.state_range)
        if self._loop.fed.acts and not least_delay(scenario.input, self.plant.nu):
            raise DesignError("y(k) depends on u(k), which is chosen after y(k): noise: {input: {delayed: 1}}")
        with np.errstate(over="ignore", invalid="ignore"):
            self.sample = self._measured()

    @property
    def is_over(self) -> bool:
        """Whether the last sample is reached or the run has failed."""
        return self.k == self.n_steps or self.sample.status != Status.OK

    def step(self, u: Float[Array, " nu"]) -> Sample:
        """Choose the input at k, which acts after the laws of the input; `u` then is what has acted from k to k+1."""
        if self.is_over:
            raise RuntimeError("the episode is over; start another one")
        k, u_k = self.k, np.array(u, dtype=float).reshape(1, self.plant.nu)
        with np.errstate(over="ignore", invalid="ignore"):
            u_k, u_m, _ = self._loop.acting(k, u_k, np.zeros(1, np.int8))
            self.u = u_k[0].copy()
            self._loop.moved(k, u_k, u_m)
            self.k = k + 1
            self.sample = self._measured()
        return self.sample

    def _measured(self) -> Sample:
        k, loop = self.k, self._loop
        y_true, y, given = loop.measured(k)
        estimate = loop.corrected(k, given)
        x_hat = None if self.method is None else estimate.x_hat[0]
        failure = self.journal.failures.get(self.run)
        status, message = _STATUSES[int(loop.status[0])], "" if failure is None else failure.message
        return Sample(k, y[0], y_true[0], loop.x[0].copy(), self.r[k : k + self.preview], x_hat, status, message)
