"""Checks of an estimator in the experiment of a user, for design models whose best estimator is not known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.estimators import FUNCTION, require_causal
from rmpc_bench.conformance.information import FRESH, InformationExample
from rmpc_bench.conformance.outcome import SEED, global_seed
from rmpc_bench.conformance.results import Check, require
from rmpc_bench.conformance.systems import EstimatorExample, LinearSystem
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Array, Estimator, Journal, as_estimate

N_RUNS, N_STEPS = 10, 150
"""Largest size of the simulation."""


class ExperimentSystem:
    """The plant, the scenario and a method of an experiment."""

    def __init__(self, experiment: Experiment, method: str) -> None:
        # The other methods and the metrics are not needed.
        self.experiment = replace(experiment, methods=(experiment.method(method),), metrics=())

    @property
    def n_steps(self) -> int:
        """Number of control periods."""
        return min(self.experiment.n_steps, N_STEPS)


System: TypeAlias = LinearSystem | ExperimentSystem
"""What a component is checked on."""


class Recording(Estimator):
    """An estimator that records its inputs and its estimates."""

    def __init__(self, design: Estimator) -> None:
        self.design = design
        self.y, self.u, self.x_hat = list[Array](), list[Array](), list[Array]()

    @property
    def starts_runs(self) -> bool:
        """As the estimator."""
        return self.design.starts_runs

    def init(self, *args: Any, **keywords: Any) -> Any:
        """Start the estimator."""
        return self.design.init(*args, **keywords)

    def correct(self, k: int, state: Any, y: Array) -> Any:
        """Keep y(k) and x_hat(k)."""
        self.y.append(y.copy())
        state, returned = self.design.correct(k, state, y)
        self.x_hat.append(np.array(as_estimate(returned).x_hat))
        return state, returned

    def predict(self, k: int, state: Any, u: Array) -> Any:
        """Keep u(k)."""
        self.u.append(u.copy())
        return self.design.predict(k, state, u)


@dataclass(frozen=True, eq=False)
class ExperimentExample(InformationExample):
    """Runs of an experiment that an estimator is checked on: its plant, scenario and method, and the design."""

    system: ExperimentSystem
    estimator: Estimator

    @cached_property
    def recording(self) -> Recording:
        """The estimator in the simulation with its controller; only runs that reach the last sample can be compared."""
        experiment, n_steps = self.system.experiment, self.system.n_steps
        [method], runs = experiment.methods, range(min(experiment.n_runs, N_RUNS))
        kept = Recording(self.estimator)
        draws = experiment.scenario.draw(experiment.plant, runs, n_steps)
        r = experiment.scenario.reference.sample(n_steps + 1 + method.controller.preview)
        start = RunStart(SEED, tuple(runs), Journal())
        with global_seed(0):
            _, status = simulate(
                experiment.plant,
                method._replace(estimator=kept),
                draws,
                r,
                n_steps,
                state_range=experiment.state_range,
                start=start,
            )
        require(not status.any(), f"{int(status.astype(bool).sum())} of {len(status)} runs fail")
        return kept

    @cached_property
    def data(self) -> EstimatorExample:
        """The measurements and inputs alone."""
        return EstimatorExample(np.stack(self.recording.y, axis=1), np.stack(self.recording.u, axis=1))

    def simulated(self, component: Estimator) -> Float[Array, "runs samples nx"]:
        """Estimates in the simulation."""
        return np.stack(self.recording.x_hat, axis=1)


def _completes(estimator: Estimator, example: ExperimentExample) -> None:
    example.in_loop(estimator)


def _causal(estimator: Estimator, example: ExperimentExample) -> None:
    require_causal(estimator, example.data, change=example.system.n_steps // 2 + 1)


ExperimentExample.checks = (
    Check("no-exception", "every call returns without an exception", _completes, is_first=True),
    FUNCTION,
    FRESH,
    Check("causal", "x_hat(k) does not depend on y after k", _causal),
)
