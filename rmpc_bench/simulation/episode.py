"""One run of an experiment with inputs from outside, sample by sample.

The random inputs, the plant and the order of the calls are those of `closed_loop.simulate`, so that a law that is
applied here gives the trajectory of the experiment, bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.simulation.angles import turned_calls
from rmpc_bench.simulation.input_channel import Feedthrough, InputChannel, least_delay
from rmpc_bench.simulation.late_measurements import Arrivals
from rmpc_bench.simulation.run_start import RunStart, RunState
from rmpc_bench.simulation.scenario import Experiment, own_draws
from rmpc_bench.simulation.state_range import OK, RunLimits
from rmpc_bench.types import Array, DesignError, Journal, KnownDelay, Method, RunInfo, Status, as_estimate, as_motion

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


class Episode:
    """A run between its first and its last sample; the estimator of the method, if any, gives estimates.

    A run beyond those of the experiment has random inputs that no run of it has.  `preview` counts r(k).
    """

    def __init__(self, experiment: Experiment, run: int, method: Method | None = None, *, preview: int = 1) -> None:
        self.plant, self.n_steps, self.run = experiment.plant, experiment.n_steps, run
        self.method, self.preview, self.k = method, preview, 0
        scenario, runs = experiment.scenario, range(run, run + 1)
        draws = scenario.draw(self.plant, runs, self.n_steps)
        self.r = scenario.reference.sample(self.n_steps + 1 + preview)
        start, self._runs = RunStart(scenario.seed, (run,), Journal()), RunState.of(1)
        self.journal = start.journal
        counted = RunInfo((run,), (), self._runs.alive, start.journal)
        delay, u_before = (KnownDelay(), ()) if method is None else (method.delay, method.u_before)
        self._channel = InputChannel(self.plant, draws.inputs, delay, u_before, counted)
        draws = own_draws(scenario, self.plant, runs, self.n_steps, draws)
        self._delta = start.plant(self.plant, draws.delta, draws.x0, self._runs)
        self._x = np.array(self.plant.first_state(self._delta, draws.x0))
        mixes = self.plant.mixes_noise
        self._draws, self._arrivals = draws, Arrivals(draws, delay)
        self._w, self._v = self.plant.mix(self._delta, draws.w, draws.v) if mixes else (draws.w, draws.v)
        estimator = None if method is None else method.estimator
        self._fed = Feedthrough(self.plant, self._channel, estimator, None, self.n_steps)
        if self._fed.acts and not least_delay(scenario.input, self.plant.nu):
            raise DesignError("y(k) depends on u(k), which is chosen after y(k): noise: {input: {delayed: 1}}")
        if method is not None:
            filter_, _ = turned_calls(method, self._fed.used_by(method.estimator), None)
            self._filter = self._arrivals.used_by(filter_)
            self._e = start.estimator(method.estimator, 1, self._delta, self._runs)
        self._limits = RunLimits(experiment.state_range, self._x, self.r[: self.n_steps + 1])
        with np.errstate(over="ignore", invalid="ignore"):
            self._status = self._runs.after(self._limits.of_state(np.full(1, OK), self._runs.failed, self._x))
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
            self._status = self._runs.after(self._limits.of_input(self._status, np.zeros(1, np.int8), u_k))
            u_k, u_m, _ = self._channel.step(k, u_k)
            self.u = u_k[0].copy()
            motion = as_motion(self.plant.step(k, self._delta, self._x.copy(), u_k.copy(), self._w[:, k]))
            self._status = self._runs.after(self._limits.of_state(self._status, motion.status, motion.x))
            if self._runs.alive.all():
                self._x = np.array(motion.x)
            if self.method is not None:
                self._e = self._filter.predict(k, self._e, self.method.controller.known_inputs(u_m.copy()))
            self.k = k + 1
            self.sample = self._measured()
        return self.sample

    def _measured(self) -> Sample:
        k, plant = self.k, self.plant
        acting = self._fed.at(k, 1)
        y_true = np.array(plant.output(k, self._delta, self._x, np.zeros_like(self._v[:, 0]), *acting))
        y = y_true + self._v[:, k]
        if not plant.mixes_noise:
            y = np.array(plant.output(k, self._delta, self._x, self._v[:, k], *acting))
        y, given = self._arrivals.at(k, self._draws.altered(k, y))
        self._status = self._runs.with_reported(self._status)
        x_hat = None
        if self.method is not None:
            self._e, answer = self._filter.correct(k, self._e, given)
            estimate = as_estimate(answer)
            x_hat, nd = np.array(estimate.x_hat), self.method.n_disturbances
            self._status = self._runs.after(self._limits.of_estimate(self._status, estimate.status, x_hat, nd))
            x_hat = x_hat[0]
        failure = self.journal.failures.get(self.run)
        status, message = _STATUSES[int(self._status[0])], "" if failure is None else failure.message
        return Sample(k, y[0], y_true[0], self._x[0].copy(), self.r[k : k + self.preview], x_hat, status, message)
