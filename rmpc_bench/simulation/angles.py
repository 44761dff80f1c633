"""Estimators and controllers with outputs that are angles: measurement and reference are turned by whole periods.

Method  An innovation beyond half a period is wrapped: the estimator gets y - p rint(e / p).  A law that follows a
        reference gets y_hat + wrap(r - y_hat), with the output y_hat of the estimate.  Runs with equal turns of
        the reference are computed together.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from rmpc_bench.types import Ahead, Array, Command, Estimate, Method, as_estimate
from rmpc_bench.types.angles import turns, wrapped

MOST = 3
"""Corrections of a sample until its innovation is within half a period; one that depends on y may need a second."""
_T = TypeVar("_T", bound=tuple[Any, ...])


def turned_calls(method: Method, estimator: Any, controller: Any) -> tuple[Any, Any]:
    """Return estimator and controller for the loop; those of a user and of other libraries wrap angles themselves."""
    if method.period is None:
        return estimator, controller
    is_built_in = type(method.estimator).__module__.startswith("rmpc_bench.estimators.")
    return (
        TurnedEstimator(method, estimator) if is_built_in else estimator,
        TurnedController(method, controller) if method.controller.compares_estimate else controller,
    )


class _Turned:
    """A component of a method in the loop; calls that are not defined here are its own."""

    def __init__(self, method: Method, component: Any) -> None:
        assert method.period is not None
        self._period, self._method, self._component = method.period, method, component

    def __getattr__(self, name: str) -> Any:
        return getattr(self._component, name)


class TurnedEstimator(_Turned):
    """The calls of a built-in estimator in the loop."""

    def correct(self, k: int, state: Any, y: Array) -> Any:
        """Correct with the measurement that is nearest to its prediction."""
        answer = self._component.correct(k, state, y)
        for _ in range(MOST - 1):
            e = as_estimate(answer[1]).info.get("e")
            n = np.zeros_like(y) if e is None else turns(e, self._period)
            if not n.any():
                break
            y = y - self._period * n
            answer = self._component.correct(k, state, y)
        return answer


class TurnedController(_Turned):
    """The calls of a controller in the loop."""

    def control_ahead(self, *given: Any) -> tuple[Any, Command]:
        """Call the controller with a prediction of the estimate."""
        return self.control(*given)

    def control(
        self, k: int, state: Any, y: Array, estimate: Estimate, r: Array, ahead: Ahead | None = None
    ) -> tuple[Any, Command]:
        """Call the controller with y and r that are nearest to the output of the estimate."""
        assert self._method.model is not None
        centre = self._method.model.measured(k, estimate.x_hat)
        y = centre + wrapped(y - centre, self._period)
        y_hat = None if ahead is None else centre + wrapped(ahead.y_hat - centre, self._period)

        def called(state: Any, y: Array, estimate: Estimate, r: Array, rows: Any) -> tuple[Any, Command]:
            if ahead is None or y_hat is None:
                return self._component.control(k, state, y, estimate, r)  # type: ignore[no-any-return]
            given = ahead._replace(y_hat=y_hat[:, rows])
            return self._component.control_ahead(k, state, y, estimate, r, given)  # type: ignore[no-any-return]

        n = turns(r - centre[:, None], self._period)
        patterns, group = np.unique(n.reshape(len(n), -1), axis=0, return_inverse=True)
        if len(patterns) == 1:
            shifted = r - self._period * patterns[0].reshape(r.shape)
            return called(state, y, estimate, shifted, slice(None))
        found, order = [], np.argsort(group.ravel(), kind="stable")
        for number, pattern in enumerate(patterns):
            rows = np.flatnonzero(group.ravel() == number)
            shifted = r - self._period * pattern.reshape(r.shape)
            parts = _chosen(state, rows), y[rows], _chosen(estimate, rows), shifted
            found.append(called(*parts, rows))
        back = np.argsort(order, kind="stable")
        states, commands = zip(*found, strict=True)
        return _joined(states, back), _joined(commands, back)


def _chosen(record: _T, rows: Array) -> _T:
    """Return a record of arrays for some runs; matrices that all runs share stay as they are."""

    def part(name: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: part(key, each) for key, each in value.items()}
        if hasattr(value, "_fields"):
            return _chosen(value, rows)
        is_shared = np.ndim(value) == 0 or (name in ("P", "M") and np.ndim(value) == 2)
        return value if is_shared else value[rows]

    return type(record)(*map(part, record._fields, record))  # type: ignore[attr-defined]


def _joined(records: tuple[_T, ...], back: Array) -> _T:
    """Put the records of groups of runs together, in the order of the runs."""

    def whole(values: tuple[Any, ...]) -> Any:
        if isinstance(values[0], Mapping):
            return {name: whole(tuple(each[name] for each in values)) for name in values[0]}
        if hasattr(values[0], "_fields"):
            return _joined(values, back)
        if all(np.ndim(value) == 0 for value in values):
            return values[0]
        # Statuses that a group leaves out are OK.
        every = [np.zeros(len(each[0]), np.int8) if np.ndim(value) == 0 else value
                 for each, value in zip(records, values, strict=True)]  # fmt: skip
        return np.concatenate(every)[back]

    return type(records[0])(*map(whole, zip(*records, strict=True)))
