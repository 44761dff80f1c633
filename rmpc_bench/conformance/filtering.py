"""Measurements and inputs that an estimator is checked with, and the estimates that it returns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.global_random import SEED, global_seed
from rmpc_bench.conformance.outcome import Outcome
from rmpc_bench.conformance.results import Check, require
from rmpc_bench.simulation.run_start import RunStart, RunState
from rmpc_bench.types import Array, Estimate, Estimator, Journal, Status, as_estimate


@dataclass(frozen=True, eq=False)
class EstimatorExample:
    """Measurements and inputs that an estimator is checked with.

    Parameters
    ----------
    y : (runs, samples, ny) measurements of at least six runs and four samples; the design must know as many samples
    u : (runs, samples, nu) inputs
    delta : for an oracle estimator: the plant's record of uncertain parameters for the runs of the given indices
    nx : length of an estimate; not checked where it is not known
    """

    y: Float[Array, "runs samples ny"]
    u: Float[Array, "runs samples nu"]
    delta: Callable[[Sequence[int]], Any] | None = None
    nx: int | None = None
    known: dict[int, tuple[Estimator, Outcome]] = field(default_factory=dict, repr=False)
    """Outcome of the whole example by component, computed once for each of the estimators."""
    checks: ClassVar[tuple[Check, ...]]

    @classmethod
    def random(
        cls, nu: int, ny: int, *, n_runs: int = 9, n_steps: int = 12, seed: int = 11, delta: Any = None
    ) -> EstimatorExample:
        """Draw standard normal measurements and inputs.

        Parameters
        ----------
        nu, ny : number of inputs and outputs
        n_runs, n_steps : size of the example; there are n_steps + 1 samples
        seed : of the generator
        delta : as above
        """
        rng = np.random.default_rng(seed)
        y, u = (rng.standard_normal((n_runs, n_steps + 1, n)) for n in (ny, nu))
        return cls(y, u, delta)

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.y)

    def start(
        self,
        estimator: Estimator,
        rows: Sequence[int],
        journal: Journal | None = None,
        shared: RunState | None = None,
    ) -> Any:
        """State of some runs before the first measurement."""
        drawn = None
        if estimator.knows_uncertainty:
            require(self.delta is not None, "the estimator knows the uncertain parameters; give the example `delta`")
            drawn = self.delta(rows) if self.delta is not None else None
        start = RunStart(SEED, tuple(int(row) for row in rows), journal or Journal())
        return start.estimator(estimator, len(rows), drawn, shared or RunState.of(len(rows)))

    def evaluate(
        self, component: Estimator, rows: Sequence[int] | None = None, *, seed: int = 0, y: Array | None = None
    ) -> Outcome:
        """Filter some runs; an exception of the estimator ends them.

        Parameters
        ----------
        component : what is checked
        rows : indices of the runs; all of them unless given
        seed : of the global random generators, which an estimator must not use
        y : other measurements
        """
        rows = range(self.n_runs) if rows is None else rows
        y = self.y if y is None else y
        shared, journal = RunState.of(len(rows)), Journal()
        status = np.zeros(len(rows), np.int8)
        outcome, k = Outcome("x_hat", [], status, journal, None, [], []), -1
        # As in the simulation, in which failed runs may overflow.
        with global_seed(seed), np.errstate(over="ignore", invalid="ignore"):
            try:
                state = self.start(component, rows, journal, shared)
                for k in range(y.shape[1]):
                    status[:] = np.where(status != Status.OK, status, shared.failed)
                    np.equal(status, Status.OK, out=shared.alive)
                    state, returned = component.correct(k, state, np.ascontiguousarray(y[rows, k]))
                    estimate = as_estimate(returned)
                    _keep(outcome, state, estimate)
                    status[:] = np.where(status != Status.OK, status, estimate.status)
                    np.equal(status, Status.OK, out=shared.alive)
                    if k < self.u.shape[1]:
                        state = component.predict(k, state, np.ascontiguousarray(self.u[rows, k]))
                        outcome.states.append(state)
            except (Exception, SystemExit) as error:  # an estimator under test may raise anything
                error.add_note(f"k = {k}" if k >= 0 else "before the first sample")
                return outcome._replace(error=error)
        return outcome

    def all(self, component: Estimator) -> Outcome:
        """Filter the whole example; computed once per estimator."""
        if id(component) not in self.known:
            self.known[id(component)] = component, self.evaluate(component)
        return self.known[id(component)][1]

    def x_hat(
        self, estimator: Estimator, rows: Sequence[int] | None = None, y: Array | None = None
    ) -> Float[Array, "runs samples nx"]:
        """Estimates of some runs over time."""
        return self.evaluate(estimator, rows, y=y).values


def _keep(outcome: Outcome, state: Any, estimate: Estimate) -> None:
    """Add the estimate of a sample; what the estimator may write into again is copied."""
    P = None if estimate.P is None else np.array(estimate.P)
    estimate = estimate._replace(x_hat=np.array(estimate.x_hat), P=P)
    outcome.states.append(state)
    outcome.returned.append(estimate)
    outcome.numbers.append(estimate.x_hat)
