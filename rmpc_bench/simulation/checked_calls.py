"""Checks of what a component returns at every call, for components that are not built in.

A wrong shape, dtype or status would otherwise be broadcast to other runs, or show as an error somewhere else.  The
floating-point warnings that the simulation switches off are switched on again during these calls, as long as no run of
the block has failed: a component goes on with the rows of failed runs, whose numbers mean nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
from jaxtyping import Bool

from rmpc_bench.types import (
    Array,
    Command,
    Controller,
    DesignError,
    Estimate,
    Estimator,
    InvalidReturnValue,
    Journal,
    Method,
    Metric,
    Motion,
    Plant,
    Record,
    Status,
    as_command,
    as_estimate,
    as_motion,
)

_STATUSES = frozenset(int(status) for status in Status)
_NUMBERS = "fiub"
_KEPT_FOR_METRICS = ("x", "x_hat", "u")


def is_own(design: Any) -> bool:
    """Whether the class of a design is not one of the bench."""
    return type(design).__module__.partition(".")[0] != "rmpc_bench"


def checked_calls(plant: Plant, method: Method, alive: Bool[Array, " runs"], journal: Journal) -> tuple[Any, Any, Any]:
    """Return plant, estimator and controller for the loop: built-in ones as they are, others with checked answers."""
    estimator, controller = method.estimator, method.controller
    return (
        CheckedPlant(plant, alive, journal) if is_own(plant) else plant,
        CheckedEstimator(estimator, alive, journal) if is_own(estimator) else estimator,
        CheckedController(controller, alive, journal, plant.nu) if is_own(controller) else controller,
    )


def metric_values(metric: Metric, record: Record) -> Array:
    """Evaluate a metric and check the shape of its values."""
    values = metric.evaluate(declared(record, metric))
    if is_own(metric):
        _check_array(values, f"evaluate of the metric {metric.name!r}", "values", (len(record.y),))
    return values


def signals_read(metric: Metric) -> Collection[str]:
    """Return the signals that a metric may read; all for a class of the user that does not say itself what it reads.

    A class that is derived from a built-in metric may read more than that.
    """
    return _KEPT_FOR_METRICS if is_own(metric) and "reads" not in vars(type(metric)) else metric.reads


def declared(record: Record, metric: Metric) -> Record:
    """Return a record that refuses to give a metric what it has not declared in `reads`."""
    found = _DeclaredRecord(*record)
    found.metric, found.missing = metric.name, {*_KEPT_FOR_METRICS} - {*signals_read(metric)}
    return found


class _DeclaredRecord(Record):
    """A record whose signals a metric must have declared in `reads`: others may have no rows."""

    metric: str = ""
    missing: Collection[str] = ()

    def _replace(self, **values: Any) -> _DeclaredRecord:
        replaced = super()._replace(**values)
        replaced.metric, replaced.missing = self.metric, self.missing
        return replaced

    def __getattribute__(self, name: str) -> Any:
        """Return an entry; a DesignError for a signal that is not declared."""
        if name in _KEPT_FOR_METRICS and name in self.missing:
            raise DesignError(f"the metric {self.metric!r} reads {name}, which its `reads` does not contain")
        return super().__getattribute__(name)


class _Checked:
    """What the checked calls of all components share."""

    def __init__(self, component: Any, alive: Bool[Array, " runs"], journal: Journal) -> None:
        self._component, self._alive, self._n, self._journal = component, alive, len(alive), journal

    def __getattr__(self, name: str) -> Callable[..., Any]:
        """Return a call of the component whose answer only itself can read, such as its next state."""
        call = getattr(self._component, name)

        def called(*given: Any) -> Any:
            with self._user_code():
                return call(*given)

        return called

    def _user_code(self) -> AbstractContextManager[None]:
        return self._journal.user_code(floating=bool(self._alive.all()))


class CheckedPlant(_Checked):
    """The calls of a plant in the loop; `alive` is updated in place."""

    def output(self, k: int, delta: Any, x: Array, v: Array, *u: Array) -> Array:
        """Return the checked output."""
        with self._user_code():
            y: Array = self._component.output(k, delta, x, v, *u)
        _check_array(y, "output", "y", (self._n, self._component.ny))
        return y

    def step(self, k: int, delta: Any, x: Array, u: Array, w: Array) -> Motion:
        """Return the checked motion."""
        with self._user_code():
            answer = self._component.step(k, delta, x, u, w)
        _check_answer(answer, "step", Motion, "x or Motion(x, status)")
        motion = as_motion(answer)
        _check_array(motion.x, "step", "x", (self._n, self._component.nx))
        _check_status(motion.status, "step", self._n)
        return motion


class CheckedEstimator(_Checked):
    """The calls of an estimator in the loop; `alive` is updated in place."""

    def __init__(self, estimator: Estimator, alive: Bool[Array, " runs"], journal: Journal) -> None:
        super().__init__(estimator, alive, journal)
        self._nx = -1

    def correct(self, k: int, state: Any, y: Array) -> tuple[Any, Estimate]:
        """Return the checked estimate."""
        with self._user_code():
            answer = self._component.correct(k, state, y)
        state, second = _pair(answer, "correct", Estimate, "(state, x_hat) or (state, Estimate)")
        estimate = as_estimate(second)
        width = np.shape(estimate.x_hat)[-1:] if self._nx < 0 else (self._nx,)
        _check_array(estimate.x_hat, "correct", "x_hat", (self._n, *width) if width else (self._n, 1))
        self._nx = nx = estimate.x_hat.shape[1]
        for name, matrix in (("P", estimate.P), ("M", estimate.M)):
            if matrix is not None:
                _check_array(matrix, "correct", name, (nx, nx), (self._n, nx, nx))
        _check_status(estimate.status, "correct", self._n)
        _check_info(estimate.info, "correct", self._n)
        return state, estimate


class CheckedController(_Checked):
    """The calls of a controller in the loop; `alive` is updated in place."""

    def __init__(self, controller: Controller, alive: Bool[Array, " runs"], journal: Journal, nu: int) -> None:
        super().__init__(controller, alive, journal)
        self._nu = nu

    def control(self, *given: Any) -> tuple[Any, Command]:
        """Return the checked input."""
        return self._checked(self._component.control, given)

    def control_ahead(self, *given: Any) -> tuple[Any, Command]:
        """Return the checked input of a law whose input acts later."""
        return self._checked(self._component.control_ahead, given)

    def _checked(self, call: Callable[..., Any], given: Sequence[Any]) -> tuple[Any, Command]:
        with self._user_code():
            answer = call(*given)
        state, second = _pair(answer, "control", Command, "(state, u) or (state, Command)")
        command = as_command(second)
        _check_array(command.u, "control", "u", (self._n, self._nu))
        for status in (command.status, command.step_status):
            if status is not None:
                _check_status(status, "control", self._n)
        _check_info(command.info, "control", self._n)
        return state, command


def _pair(answer: Any, call: str, record: type, right: str) -> tuple[Any, Any]:
    if not (isinstance(answer, tuple) and len(answer) == 2):
        raise InvalidReturnValue(f"{call} returned {_described(answer)}; it must return {right}")
    _check_answer(answer[1], call, record, right)
    return answer


def _check_answer(answer: Any, call: str, record: type, right: str) -> None:
    if not isinstance(answer, record | np.ndarray | list):
        raise InvalidReturnValue(f"{call} returned {_described(answer)}; it must return {right}")


def _check_array(value: Any, call: str, name: str, *shapes: tuple[int, ...]) -> None:
    fits = isinstance(value, np.ndarray) and value.dtype.kind in _NUMBERS and value.shape in shapes
    if not fits:
        right = " or ".join(map(str, shapes))
        raise InvalidReturnValue(
            f"{call} returned {name} as {_described(value)}; it must be an array of numbers {right}"
        )


def _check_status(status: Any, call: str, n_runs: int) -> None:
    right = isinstance(status, np.ndarray) and status.dtype.kind in "iu" and status.shape == (n_runs,)
    if not right:
        wrong = _described(status)
        raise InvalidReturnValue(f"{call} returned the status as {wrong}; it must be an array of integers ({n_runs},)")
    if status.any() and (unknown := set(status.tolist()) - _STATUSES):
        raise InvalidReturnValue(f"{call} returned the status {min(unknown)}; the statuses are 0 to {max(_STATUSES)}")


def _check_info(info: Any, call: str, n_runs: int) -> None:
    if not hasattr(info, "items"):
        raise InvalidReturnValue(f"{call} returned info as {_described(info)}; it must be a mapping of arrays")
    for name, value in info.items():
        if not (isinstance(value, np.ndarray) and value.dtype.kind in _NUMBERS and value.shape[:1] == (n_runs,)):
            raise InvalidReturnValue(
                f"{call} returned info[{name!r}] as {_described(value)}; axis 0 of the array must be the run ({n_runs})"
            )


def _described(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} of shape {value.shape}"
    return "None" if value is None else f"an object of type {type(value).__name__}"
