"""Checks of controllers: shapes, purity, and runs that do not depend on the block they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.failures import require_valid_return_values
from rmpc_bench.conformance.global_random import SEED, global_seed
from rmpc_bench.conformance.outcome import REPETITION, Outcome, first_checks, refuse_objects
from rmpc_bench.conformance.results import Check, NotApplicableError, copies, require, require_same, require_unchanged
from rmpc_bench.simulation.run_start import RunStart, RunState
from rmpc_bench.types import Array, Command, Controller, Estimate, Journal, Status, as_command


@dataclass(frozen=True, eq=False)
class ControllerExample:
    """Estimates, measurements and a reference that a controller is checked with.

    Every estimate has a set M of its own for each run and a mean of the process noise, `w_mean`, so that a controller
    that uses them finds them.

    Parameters
    ----------
    x_hat : (runs, steps, nx) estimates of at least six runs and four samples
    y : (runs, steps, ny) measurements
    r : (samples, ny) reference, at least steps + preview samples
    nu : number of inputs; not checked where it is not known
    """

    x_hat: Float[Array, "runs steps nx"]
    y: Float[Array, "runs steps ny"]
    r: Float[Array, "samples ny"]
    nu: int | None = None
    pair: tuple[Controller, Controller] | None = None
    """The law without limits of its own, and with equal ones for all inputs; None where it has no such key."""
    known: dict[int, tuple[Controller, Outcome]] = field(default_factory=dict, repr=False)
    """Outcome of the whole example by component, computed once for each of the controllers."""
    checks: ClassVar[tuple[Check, ...]]

    @classmethod
    def random(
        cls, nx: int, ny: int, preview: int, *, n_runs: int = 9, n_steps: int = 12, seed: int = 12
    ) -> ControllerExample:
        """Draw standard normal estimates, measurements and a reference.

        Parameters
        ----------
        nx, ny : number of states and outputs
        preview : samples of the reference that the controller sees
        n_runs, n_steps : size of the example
        seed : of the generator
        """
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

    def start(self, controller: Controller, rows: Sequence[int], journal: Journal, shared: RunState) -> Any:
        """State of some runs before the first sample."""
        return RunStart(SEED, tuple(int(row) for row in rows), journal).controller(controller, len(rows), shared)

    def evaluate(
        self,
        component: Controller,
        rows: Sequence[int] | None = None,
        *,
        seed: int = 0,
        bounds: tuple[float, float] | None = None,
    ) -> Outcome:
        """Control some runs, with bounds of the plant where they are given; an exception ends them."""
        rows = range(self.n_runs) if rows is None else rows
        shared, journal = RunState.of(len(rows)), Journal()
        status = np.zeros(len(rows), np.int8)
        outcome, k = Outcome("u", [], status, journal, None, [], []), -1
        with global_seed(seed), np.errstate(over="ignore", invalid="ignore"):
            try:
                state = self.start(component, rows, journal, shared)
                for k in range(self.x_hat.shape[1]):
                    status[:] = np.where(status != Status.OK, status, shared.failed)
                    np.equal(status, Status.OK, out=shared.alive)
                    state, command = self.step(component, k, state, rows)
                    command = command._replace(u=np.array(command.u))
                    if bounds is not None:
                        command = command._replace(u=np.clip(command.u, *bounds))
                        state = component.applied(k, state, command.u.copy())
                    outcome.states.append(state)
                    outcome.returned.append(command)
                    outcome.numbers.append(command.u)
                    status[:] = np.where(status != Status.OK, status, command.status)
                    np.equal(status, Status.OK, out=shared.alive)
            except (Exception, SystemExit) as error:  # a controller under test may raise anything
                error.add_note(f"k = {k}" if k >= 0 else "before the first sample")
                return outcome._replace(error=error)
        return outcome

    def all(self, component: Controller) -> Outcome:
        """Control the whole example; computed once per controller."""
        if id(component) not in self.known:
            self.known[id(component)] = component, self.evaluate(component)
        return self.known[id(component)][1]

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
        return self.evaluate(controller).values


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


def _begun(controller: Controller, example: ControllerExample) -> Any:
    """State before the first sample of a controller without objects."""
    state = example.start(controller, range(example.n_runs), Journal(), RunState.of(example.n_runs))
    refuse_objects(controller, state)
    return state


def _arguments(controller: Controller, example: ControllerExample) -> None:
    state = _begun(controller, example)
    for k in range(3):
        estimate = example.estimate(example.x_hat[:, k])
        x_hat, y, r = estimate.x_hat, example.y[:, k].copy(), example.r[k : k + controller.preview].copy()
        arguments = [*(state or ()), x_hat, y, r, estimate.status, estimate.P, estimate.M, estimate.info["w_mean"]]
        before = copies(arguments)
        state, _ = controller.control(k, state, y, estimate, r)
        require_unchanged(arguments, before)


def _purity(controller: Controller, example: ControllerExample) -> None:
    state = _begun(controller, example)
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
    outcome = ControllerExample(x_hat, y, example.r).evaluate(controller)
    found, expected = outcome.values, example.u(controller)
    require_same("u of the other runs", np.delete(found, run, axis=0), np.delete(expected, run, axis=0))
    require_same("u before the missing sample", found[run, :k], expected[run, :k])
    require(
        bool(outcome.status[run]) or bool(np.isnan(found[run, k]).all()), "u is finite although the estimate is missing"
    )


def _applied(controller: Controller, example: ControllerExample) -> None:
    repeated = example.evaluate(controller, bounds=(-np.inf, np.inf)).values
    require_same("u after `applied` with the input that `control` has returned", repeated, example.u(controller))
    if example.pair is None:
        text = "the law has no key `limits` of the form {u: [low, high]}"
        raise NotApplicableError(f"{text}, so that bounds of the plant cannot be compared with it")
    free, limited = example.pair
    assert limited.input_limits is not None
    low, high = (float(np.min(each)) for each in limited.input_limits)
    found, expected = example.evaluate(free, bounds=(low, high)).values, example.u(limited)
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
