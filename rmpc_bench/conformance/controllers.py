"""Checks of controllers: shapes, purity, independence of other runs, and the information that u(k) depends on.

u(k) depends on x_hat and y up to k, and on the samples of r within the preview.  The plant of these checks has a given
input, so that its states are bounded whatever the controller returns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.information import CHANGE, FRESH, InformationExample, function_of_data, require_no_lookahead
from rmpc_bench.conformance.outcome import REPETITION, Outcome, RunsExample, first_checks, require_valid_return_values
from rmpc_bench.conformance.results import Check, NotApplicableError, copies, require, require_same, require_unchanged
from rmpc_bench.conformance.systems import GivenEstimates, LinearGaussian, LinearSystem, simulated
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import Array, Command, Controller, Estimate, Method, Motion, as_command


@dataclass(frozen=True, eq=False)
class ControllerExample(RunsExample):
    """Estimates, measurements and a reference that a controller is checked with.

    Every estimate has a set M of its own for each run and a mean of the process noise, `w_mean`, so that a controller
    that uses them finds them.
    """

    x_hat: Float[Array, "runs steps nx"]  # estimates of at least six runs and four samples
    y: Float[Array, "runs steps ny"]  # measurements
    r: Float[Array, "samples ny"]  # reference, at least steps + preview samples
    nu: int | None = None  # number of inputs; not checked where it is not known
    pair: tuple[Controller, Controller] | None = None
    """The law without limits of its own, and with equal ones for all inputs; None where it has no such key."""
    bounds: tuple[float, float] | None = None
    """Bounds of the plant for every input; the controller gets the input that acts."""
    noun: ClassVar[str] = "u"

    @classmethod
    def random(
        cls, nx: int, ny: int, preview: int, *, n_runs: int = 9, n_steps: int = 12, seed: int = 12
    ) -> ControllerExample:
        """Draw standard normal estimates, measurements and a reference; the controller sees `preview` samples of it."""
        rng = np.random.default_rng(seed)
        r = rng.standard_normal((n_steps + preview, ny))
        x_hat, y = (rng.standard_normal((n_runs, n_steps, n)) for n in (nx, ny))
        return cls(x_hat, y, r)

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.x_hat)

    def estimate(self, x_hat: Float[Array, "runs nx"]) -> Estimate:
        """Estimate with everything that a controller may use."""
        n_runs, nx = x_hat.shape
        M = np.eye(nx) * (1.0 + x_hat[:, :1] ** 2)[:, :, None]
        P = np.tile(0.1 * np.eye(nx), (n_runs, 1, 1))
        return Estimate(x_hat.copy(), P, M, np.zeros(n_runs, dtype=np.int8), {"w_mean": 0.1 * x_hat})

    def start(self, component: Controller, outcome: Outcome) -> Any:
        """State of some runs before the first sample."""
        return outcome.start.controller(component, len(outcome.rows), outcome.shared)

    def call(self, component: Controller, outcome: Outcome) -> None:
        """Control some runs."""
        state = self.start(component, outcome)
        for k in outcome.samples(self.x_hat.shape[1]):
            outcome.add_status(outcome.shared.failed)
            state, command = self.step(component, k, state, outcome.rows)
            command = command._replace(u=np.array(command.u))
            if self.bounds is not None:
                command = command._replace(u=np.clip(command.u, *self.bounds))
                state = component.applied(k, state, command.u.copy())
            outcome.states.append(state)
            outcome.returned.append(command)
            outcome.numbers.append(command.u)
            outcome.add_status(command.status)

    def step(
        self, controller: Controller, k: int, state: Any, rows: Sequence[int] | None = None
    ) -> tuple[Any, Command]:
        """Control some runs at k."""
        chosen = slice(None) if rows is None else rows
        x_hat, y = (np.ascontiguousarray(array[chosen, k]) for array in (self.x_hat, self.y))
        r = self.r[k : k + controller.preview].copy()
        state, command = controller.control(k, state, y, self.estimate(x_hat), r)
        return state, as_command(command)

    def u(self, controller: Controller) -> Float[Array, "runs steps nu"]:
        """Inputs of all runs over time."""
        return self.results(controller)


def _base_class(controller: Any, _: ControllerExample) -> None:
    require(isinstance(controller, Controller), f"{type(controller).__name__} is not a subclass of Controller")
    require(controller.preview >= 0, f"preview is {controller.preview}, a negative number of samples")


def _shapes(controller: Controller, example: ControllerExample) -> None:
    outcome, n_runs = example.all(controller), example.n_runs
    require_valid_return_values(outcome.journal, "shape")
    if not controller.starts_runs:
        state = controller.init(n_runs)
        require(state is None or all(len(array) == n_runs for array in state), "axis 0 of the state is not the run")
    nu = outcome.returned[0].u.shape[-1] if example.nu is None else example.nu
    for k, command in enumerate(outcome.returned):
        require(command.u.shape == (n_runs, nu), f"u has shape {command.u.shape} at k = {k} instead of {(n_runs, nu)}")
        require(command.u.dtype == np.float64, f"u is {command.u.dtype}, not float64")
        require(command.status.dtype == np.int8, f"status is {command.status.dtype}, not int8")
        for name, values in command.info.items():
            require(len(values) == n_runs, f"info[{name!r}] has {len(values)} rows for {n_runs} runs")


def _arguments(controller: Controller, example: ControllerExample) -> None:
    state = example.begun(controller)
    for k in range(3):
        estimate = example.estimate(example.x_hat[:, k])
        x_hat, y, r = estimate.x_hat, example.y[:, k].copy(), example.r[k : k + controller.preview].copy()
        arguments = [*(state or ()), x_hat, y, r, estimate.status, estimate.P, estimate.M, estimate.info["w_mean"]]
        before = copies(arguments)
        state, _ = controller.control(k, state, y, estimate, r)
        require_unchanged(arguments, before)


def _purity(controller: Controller, example: ControllerExample) -> None:
    state = example.begun(controller)
    for k in range(3):
        (new, first), (again, second) = (example.step(controller, k, state) for _ in range(2))
        require_same("u", second.u, first.u)
        for number, (left, right) in enumerate(zip(new or (), again or (), strict=True)):
            require_same(f"state[{number}]", right, left)
        state = new


def _missing(controller: Controller, example: ControllerExample) -> None:
    run, k = example.n_runs // 2, 3
    x_hat, y = example.x_hat.copy(), example.y.copy()
    x_hat[run, k], y[run, k] = np.nan, np.nan
    outcome = example.changed(x_hat=x_hat, y=y).evaluate(controller)
    found, expected = outcome.values, example.u(controller)
    require_same("u of the other runs", np.delete(found, run, axis=0), np.delete(expected, run, axis=0))
    require_same("u before the missing sample", found[run, :k], expected[run, :k])
    require(
        bool(outcome.status[run]) or bool(np.isnan(found[run, k]).all()), "u is finite although the estimate is missing"
    )


def _applied(controller: Controller, example: ControllerExample) -> None:
    repeated = example.changed(bounds=(-np.inf, np.inf)).u(controller)
    require_same("u after `applied` with the input that `control` has returned", repeated, example.u(controller))
    if example.pair is None:
        text = "the law has no key `limits` of the form {u: [low, high]}"
        raise NotApplicableError(f"{text}, so that bounds of the plant cannot be compared with it")
    free, limited = example.pair
    assert limited.input_limits is not None
    low, high = (float(np.min(each)) for each in limited.input_limits)
    found, expected = example.changed(bounds=(low, high)).u(free), example.u(limited)
    equal = np.allclose(found, expected, rtol=1e-9, atol=1e-9 * high, equal_nan=True)
    require(equal, "with bounds of the plant u differs from u with equal limits of its own; see `Controller.applied`")


FIRST = first_checks(
    Check("base-class", "the controller is a subclass of Controller", _base_class, is_first=True),
    _shapes,
    "axis 0 is the run; numbers are float64, the status is int8",
)
ControllerExample.checks = (
    *FIRST,
    Check("arguments", "control leaves its arguments unchanged", _arguments),
    Check("purity", "the same call twice gives the same bits", _purity),
    *REPETITION,
    Check("missing-estimate", "a missing estimate of one run changes no other run", _missing),
    Check("applied-input", "bounds of the plant act as equal limits of its own: it remembers the applied u", _applied),
)


class DrivenPlant(LinearGaussian):
    """A linear plant on which a given input acts."""

    def __init__(self, model: LinearModel, u: Float[Array, "runs steps nu"]) -> None:
        super().__init__(model)
        self.u = u

    def step(self, k: int, delta: None, x: Array, u: Array, w: Array) -> Motion:
        """Move to x(k+1) with the given input."""
        return super().step(k, delta, x, self.u[:, k], w)


@dataclass(frozen=True, eq=False)
class ControllerInformationExample(InformationExample):
    """Runs of a linear Gaussian system that a controller is checked on."""

    system: LinearSystem  # the system with the random inputs of its runs
    preview: int  # samples of the reference that the controller sees
    regulates: bool = False  # whether its reference is 0

    @cached_property
    def _samples(self) -> tuple[Array, Array]:
        """Estimates of the Kalman filter, and the measurements, at all samples."""
        recorded = self.system.recorded()
        return self.system.simulated(self.system.kalman).x_hat, recorded.y

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

    def simulated(self, component: Controller) -> Float[Array, "runs steps nu"]:
        """Inputs in the simulation, where there is a plant."""
        system, data, x_hat = self.system, self.data, self._samples[0]
        estimates = GivenEstimates(lambda k, y: data.estimate(np.ascontiguousarray(x_hat[:, k])))
        method = Method("checked", estimates, component)
        plant = DrivenPlant(system.model, system.u)
        return simulated(plant, method, system.draws(), self.r, system.n_steps)[0].u


def _compared(controller: Controller, data: ControllerExample, changed: ControllerExample, what: str) -> None:
    """Compare u(0)..u(CHANGE - 1) with other data from there on."""
    before, after = (
        [each.evaluate(controller, range(5)).values for _ in range(n)] for each, n in ((data, 3), (changed, 2))
    )
    require_no_lookahead(before, after, CHANGE, f"{what} u")


def _changed(values: Array, first: int, axis: int) -> Array:
    """Return values that differ from a sample on."""
    changed = np.moveaxis(values.copy(), axis, 0)
    changed[first:] += 3.0 * np.random.default_rng(19).standard_normal(changed[first:].shape)
    return np.moveaxis(changed, 0, axis)


def _causal(controller: Controller, example: ControllerInformationExample) -> None:
    data = example.data
    other = data.changed(x_hat=_changed(data.x_hat, CHANGE, 1), y=_changed(data.y, CHANGE, 1))
    _compared(controller, data, other, f"with other y and x_hat from k = {CHANGE} on")


def _preview(controller: Controller, example: ControllerInformationExample) -> None:
    if example.regulates:
        raise NotApplicableError("a regulator has no reference")
    data, first = example.data, CHANGE - 1 + max(controller.preview, 1)
    other = data.changed(r=_changed(data.r, first, 0))
    _compared(controller, data, other, f"with another r from k = {first} on, beyond its preview,")


ControllerInformationExample.checks = (
    Check("function-of-data", "u depends on x_hat, y, r and the model only, not on the plant", function_of_data),
    FRESH,
    Check("causal", "u(k) does not depend on y and x_hat after k", _causal),
    Check("preview", "u(k) does not depend on r beyond the preview", _preview),
)
