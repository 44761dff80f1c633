"""Checks of controllers: shapes, purity, and runs that do not depend on the block they share."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.results import Check, copies, require, require_frozen, require_same, require_unchanged
from rmpc_bench.types import Array, Command, Controller, Estimate, Status


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
    """

    x_hat: Float[Array, "runs steps nx"]
    y: Float[Array, "runs steps ny"]
    r: Float[Array, "samples ny"]
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
        M = np.eye(x_hat.shape[1]) * (1.0 + x_hat[:, :1] ** 2)[:, :, None]
        return Estimate(x_hat, None, M, np.zeros(len(x_hat), dtype=np.int8), {"w_mean": 0.1 * x_hat})

    def step(self, controller: Controller, k: int, state: Any) -> tuple[Any, Command]:
        """Control all runs at k."""
        x_hat, y = (np.ascontiguousarray(array[:, k]) for array in (self.x_hat, self.y))
        return controller.control(k, state, y, self.estimate(x_hat), self.r[k : k + controller.preview])

    def commands(self, controller: Controller) -> list[Command]:
        """Commands of all runs over time."""
        state, commands = controller.init(self.n_runs), []
        for k in range(self.x_hat.shape[1]):
            state, command = self.step(controller, k, state)
            commands.append(command)
        return commands

    def u(self, controller: Controller) -> Float[Array, "runs steps nu"]:
        """Inputs of all runs over time."""
        return np.stack([command.u for command in self.commands(controller)], axis=1)

    def some(self, rows: Any) -> ControllerExample:
        """The same example with some of the runs."""
        return ControllerExample(self.x_hat[rows], self.y[rows], self.r)


def _base_class(controller: Any, _: ControllerExample) -> None:
    require(isinstance(controller, Controller), f"{type(controller).__name__} is not a subclass of Controller")
    require(controller.preview >= 1, f"preview is {controller.preview}; a controller sees r(k) at least")
    require_frozen(controller)


def _shapes(controller: Controller, example: ControllerExample) -> None:
    n_runs = example.n_runs
    require(all(len(array) == n_runs for array in controller.init(n_runs)), "axis 0 of the state is not the run")
    commands = example.commands(controller)
    nu = commands[0].u.shape[-1]
    for command in commands:
        require(command.u.shape == (n_runs, nu), f"u has shape {command.u.shape}")
        require(command.u.dtype == np.float64, f"u is {command.u.dtype}, not float64")
        require(command.status.dtype == np.int8, f"status is {command.status.dtype}, not int8")
        require_same("status", command.status, np.full(n_runs, Status.OK, dtype=np.int8))
        for name, values in command.info.items():
            require(len(values) == n_runs, f"info[{name!r}] has {len(values)} rows for {n_runs} runs")


def _arguments(controller: Controller, example: ControllerExample) -> None:
    state = controller.init(example.n_runs)
    for k in range(3):
        estimate = example.estimate(example.x_hat[:, k])
        arguments = [*state, example.x_hat, example.y, example.r, estimate.status, estimate.M, estimate.info["w_mean"]]
        before = copies(arguments)
        r = example.r[k : k + controller.preview]
        state, _ = controller.control(k, state, example.y[:, k], estimate, r)
        require_unchanged(arguments, before)


def _purity(controller: Controller, example: ControllerExample) -> None:
    state = controller.init(example.n_runs)
    for k in range(3):
        (new, first), (again, second) = (example.step(controller, k, state) for _ in range(2))
        require_same("u", second.u, first.u)
        for number, (left, right) in enumerate(zip(new, again, strict=True)):
            require_same(f"state[{number}]", right, left)
        state = new


def _alone(controller: Controller, example: ControllerExample) -> None:
    together = example.u(controller)
    for run in range(example.n_runs):
        require_same(f"u of run {run} alone", example.some([run]).u(controller), together[run : run + 1])


def _order(controller: Controller, example: ControllerExample) -> None:
    order = np.random.default_rng(5).permutation(example.n_runs).tolist()
    require_same("u in another order", example.some(order).u(controller), example.u(controller)[order])


def _pickle(controller: Controller, example: ControllerExample) -> None:
    copy = pickle.loads(pickle.dumps(controller))
    require_same("u of the copy", example.u(copy), example.u(controller))


def _missing(controller: Controller, example: ControllerExample) -> None:
    run, k, broken = example.n_runs // 2, 3, example.some(slice(None))
    x_hat, y = broken.x_hat.copy(), broken.y.copy()
    x_hat[run, k], y[run, k] = np.nan, np.nan
    found, expected = ControllerExample(x_hat, y, example.r).u(controller), example.u(controller)
    require_same("u of the other runs", np.delete(found, run, axis=0), np.delete(expected, run, axis=0))
    require_same("u before the missing sample", found[run, :k], expected[run, :k])
    require(bool(np.isnan(found[run, k]).all()), "u hides a missing estimate")


ControllerExample.checks = (
    Check("base-class", "the controller is a frozen subclass of Controller that sees r(k) at least", _base_class),
    Check("shapes", "axis 0 is the run; status is int8", _shapes),
    Check("arguments", "control leaves its arguments unchanged", _arguments),
    Check("purity", "the same call twice gives the same bits", _purity),
    Check("batch-independence", "a run gives the same bits alone and inside any block", _alone),
    Check("order", "permuting the runs permutes the inputs, bit for bit", _order),
    Check("pickle", "a copy made by pickle gives the same bits", _pickle),
    Check("missing-estimate", "a missing estimate of one run changes no other run", _missing),
)
