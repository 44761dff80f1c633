"""Checks of the information that u(k) depends on: x_hat and y up to k, and the samples of r within the preview.

The plant of these checks has a given input, so that its states are bounded whatever the controller returns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.controllers import ControllerExample
from rmpc_bench.conformance.estimator_information import CHANGE, FRESH, function_of_data
from rmpc_bench.conformance.global_random import SEED, global_seed
from rmpc_bench.conformance.linear_system import LinearGaussian, LinearSystem
from rmpc_bench.conformance.results import Check, NotApplicableError, Returned
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.types import Array, Controller, Estimate, Estimator, Journal, Method, Motion


class DrivenPlant(LinearGaussian):
    """A linear plant with a given input.

    Parameters
    ----------
    model : its matrices
    u : (runs, steps, nu) input that acts
    """

    def __init__(self, model: LinearModel, u: Float[Array, "runs steps nu"]) -> None:
        super().__init__(model)
        self.u = u

    def step(self, k: int, delta: None, x: Array, u: Array, w: Array) -> Motion:
        """Move to x(k+1) with the given input."""
        return super().step(k, delta, x, self.u[:, k], w)


class GivenEstimates(Estimator):
    """Estimates that were computed before.

    Parameters
    ----------
    example : contains them
    x_hat : (runs, samples, nx)
    """

    def __init__(self, example: ControllerExample, x_hat: Float[Array, "runs samples nx"]) -> None:
        self.example, self.x_hat = example, x_hat

    def init(self, n_runs: int) -> None:
        """There is nothing to remember."""

    def correct(self, k: int, state: None, y: Array) -> tuple[None, Estimate]:
        """Return the estimate of k."""
        return None, self.example.estimate(np.ascontiguousarray(self.x_hat[:, k]))

    def predict(self, k: int, state: None, u: Array) -> None:
        """There is nothing to predict."""


class ControllerData(NamedTuple):
    """Everything that a controller may use of some runs."""

    x_hat: Float[Array, "runs steps nx"]
    y: Float[Array, "runs steps ny"]
    r: Float[Array, "samples ny"]

    def results(self, controller: Controller) -> Float[Array, "runs steps nu"]:
        """Return the inputs."""
        return ControllerExample(*self).u(controller)


@dataclass(frozen=True, eq=False)
class ControllerInformationExample:
    """Runs of a linear Gaussian system that a controller is checked on.

    Parameters
    ----------
    system : the system with the random inputs of its runs
    preview : samples of the reference that the controller sees
    separate_process : repeats the controller in a process without a plant, as in `EstimatorInformationExample`
    """

    system: LinearSystem
    preview: int
    separate_process: Callable[[ControllerData, bool], Returned] | None = None
    regulates: bool = False
    checks: ClassVar[tuple[Check, ...]]
    noun: ClassVar[str] = "u"

    @cached_property
    def _samples(self) -> tuple[Array, Array]:
        """Estimates of the Kalman filter, and the measurements, at all samples."""
        recorded = self.system.recorded()
        record, _ = self.system.simulated(self.system.kalman)
        return record.x_hat, recorded.y

    @cached_property
    def r(self) -> Float[Array, "samples ny"]:
        """A random reference; 0 for a regulator."""
        n = self.system.n_steps + 1 + self.preview
        r = np.random.default_rng(18).standard_normal((n, self.system.model.ny))
        return 0.0 * r if self.regulates else r

    @cached_property
    def data(self) -> ControllerExample:
        """What the controller may use."""
        x_hat, y = (each[:, :-1] for each in self._samples)
        return ControllerExample(x_hat, y, self.r, self.system.model.nu)

    @cached_property
    def _loops(self) -> dict[int, tuple[Controller, Array]]:
        return {}

    def in_loop(self, controller: Controller) -> Float[Array, "runs steps nu"]:
        """Inputs in the simulation, where there is a plant; computed once per controller."""
        if id(controller) not in self._loops:
            system = self.system
            method = Method("checked", GivenEstimates(self.data, self._samples[0]), controller)
            plant, start = DrivenPlant(system.model, system.u), RunStart(SEED, tuple(range(system.n_runs)), Journal())
            with global_seed(0):
                record, _ = simulate(plant, method, system.draws(), self.r, system.n_steps, start=start)
            self._loops[id(controller)] = controller, record.u
        return self._loops[id(controller)][1]

    def away(self, *, same: bool) -> Returned:
        """Inputs in a process without a plant."""
        if self.separate_process is None:
            raise NotApplicableError("needs another process")
        return self.separate_process(ControllerData(self.data.x_hat, self.data.y, self.r), same)


def _compared(controller: Controller, before: ControllerExample, after: ControllerExample, what: str) -> None:
    """Compare u(0)..u(CHANGE - 1) with other data from there on.

    Both several times: a controller may remember the data of an earlier method and use them as the future.
    """
    _, first, second = (before.evaluate(controller, range(5)).values[:, :CHANGE] for _ in range(3))
    if not np.array_equal(first, second, equal_nan=True):
        raise NotApplicableError("the same data give other numbers, see `repeated`")
    for _ in range(2):
        found = after.evaluate(controller, range(5)).values[:, :CHANGE]
        differs = (found != second) & ~((found != found) & (second != second))
        if differs.any():
            ahead = CHANGE - int(np.flatnonzero(differs.any(axis=(0, 2)))[0])
            raise AssertionError(f"uses the future: {what} u changes {ahead} sample{'s' if ahead > 1 else ''} ahead")


def _changed(values: Array, first: int, axis: int) -> Array:
    """Return values that differ from a sample on."""
    changed = np.moveaxis(values.copy(), axis, 0)
    changed[first:] += 3.0 * np.random.default_rng(19).standard_normal(changed[first:].shape)
    return np.moveaxis(changed, 0, axis)


def _causal(controller: Controller, example: ControllerInformationExample) -> None:
    data = example.data
    other = ControllerExample(_changed(data.x_hat, CHANGE, 1), _changed(data.y, CHANGE, 1), data.r)
    _compared(controller, data, other, f"with other y and x_hat from k = {CHANGE} on")


def _preview(controller: Controller, example: ControllerInformationExample) -> None:
    if example.regulates:
        raise NotApplicableError("a regulator has no reference")
    data, first = example.data, CHANGE - 1 + max(controller.preview, 1)
    other = ControllerExample(data.x_hat, data.y, _changed(data.r, first, 0))
    _compared(controller, data, other, f"with another r from k = {first} on, beyond its preview,")


ControllerInformationExample.checks = (
    Check("function-of-data", "u depends on x_hat, y, r and the model only, not on the plant", function_of_data),
    FRESH,
    Check("causal", "u(k) does not depend on y and x_hat after k", _causal),
    Check("preview", "u(k) does not depend on r beyond the preview", _preview),
)
