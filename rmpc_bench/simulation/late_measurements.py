"""Measurements that arrive late: what arrives at every sample, and any filter that uses it with its time.

Model   The value of sample j arrives at j + d(j), D the longest delay.  A method whose design model knows the delays
        gets every value with its time.  One that does not counts the newest value that arrives at k as y(k), or as
        y(k - n) with a number n; nothing newer is a missing measurement.
Method  The filter keeps its state at k - D and the last D inputs.  At k it repeats its steps from there with what has
        arrived by k, NaN elsewhere.  Its e and S are those of the samples that are used for the first time.
Limit   Constant delays: the filter of the model that is augmented by the last D outputs.
Cost    D + 1 corrections per sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.simulation.scenario import Draws
from rmpc_bench.types import Array, Estimate, KnownDelay, Status, as_estimate


class Arrivals:
    """What arrives at every sample in the runs of a block; it is asked sample by sample."""

    def __init__(self, draws: Draws, known: KnownDelay) -> None:
        late = [each for each in draws.alterations if each.law.longest_delay]
        self._known, self._longest = known.measurement, sum(each.law.longest_delay for each in late)
        self._d: Array = sum((each.drawn for each in late), np.zeros(()))
        self._y: list[Array] = []
        """The last measurements, from the newest one on."""
        self._newest: Any = -1
        """Newest sample that has arrived, of every run and output."""
        self.D = self._longest if self._known is None else max(self._known, default=0)
        """Longest delay that the filter counts with."""

    def used_by(self, estimator: Any) -> Any:
        """Return what calls the estimator with what `at` gives for it."""
        return LateFilter(estimator, self.D) if self.D else estimator

    def at(self, k: int, y: Float[Array, "runs ny"]) -> tuple[Float[Array, "runs ny"], Any]:
        """Return the newest values that arrive at k, and what the filter gets; `y` is measured at k."""
        by_age = self._by_age(k, y)
        now = self._newest_of(k, by_age) if self._longest else y
        if not self.D:
            return now, now
        if self._known is None:
            return now, by_age
        return now, [np.where(np.equal(self._known, age), now, np.nan) for age in range(self.D + 1)]

    def _by_age(self, k: int, y: Array) -> list[Array]:
        """Return the values of the samples k, k - 1, .. that arrive at k, NaN elsewhere."""
        if not self._longest:
            return [y]
        self._y = [y.copy(), *self._y][: self._longest + 1]
        return [np.where(self._d[:, k - age] == age, each, np.nan) for age, each in enumerate(self._y)]

    def _newest_of(self, k: int, by_age: Sequence[Array]) -> Array:
        """Return the newest of them, where none has arrived earlier that is newer."""
        now, newest = np.full_like(by_age[0], np.nan), self._newest
        for age, values in reversed([*enumerate(by_age)]):
            newer = ~np.isnan(values) & (k - age > newest)
            now, newest = np.where(newer, values, now), np.where(newer, k - age, newest)
        self._newest = newest
        return now


class LateState(NamedTuple):
    """State of a filter that repeats its last steps."""

    base: Any  # state of the filter before the correction with the oldest sample of which something may still arrive
    y: tuple[Float[Array, "runs ny"], ...]  # what has arrived of the last samples, from the newest one on
    u: tuple[Float[Array, "runs nu"], ...]  # the inputs of these samples, from the oldest one on


class LateFilter:
    """The calls of an estimator in the loop, repeated for the samples that late measurements change."""

    def __init__(self, estimator: Any, D: int) -> None:
        self._estimator, self._D = estimator, D

    def correct(self, k: int, state: Any, arrived: Sequence[Array]) -> tuple[LateState, Estimate]:
        """Repeat the last steps with what arrives at k, by the age of the sample; the first state is the filter's."""
        nothing = np.full_like(arrived[0], np.nan)
        base, old, u = state if k else (state, (), ())
        known = [nothing, *old]
        y = tuple(np.where(np.isnan(new), had, new) for new, had in zip(arrived, known, strict=False))
        # At k >= D the base moves on, and the one before is not needed again.
        now = base if k >= self._D else self._estimator.copied(base)
        first, used = max(0, k - self._D), Innovations(nothing)
        status = np.zeros(len(nothing), dtype=np.int8)
        for j in range(first, k + 1):
            now, answer = self._estimator.correct(j, now, y[k - j].copy())
            estimate = as_estimate(answer)
            status = np.where(status == Status.OK, estimate.status, status)
            used.add(~np.isnan(arrived[k - j]), estimate.info)
            if j < k:
                now = self._estimator.predict(j, now, u[j - first].copy())
            if j == k - self._D:
                base = self._estimator.copied(now)
        info = {**estimate.info, **used.entries(estimate.info)}
        return LateState(base, y[: self._D], u), estimate._replace(status=status, info=info)

    def predict(self, k: int, state: LateState, u: Float[Array, "runs nu"]) -> LateState:
        """Keep u(k) for the next correction."""
        return state._replace(u=(*state.u, u.copy())[-self._D :])


class Innovations:
    """Innovations of the samples that are used for the first time, and their covariance, which is 0 between samples."""

    def __init__(self, nothing: Float[Array, "runs ny"]) -> None:
        self._e, self._steps = nothing, list[tuple[Array, Any]]()

    def add(self, new: Array, info: Any) -> None:
        """Take those of a later sample, for the outputs that are new."""
        if np.shape(info.get("e")) == new.shape:
            self._e = np.where(new, info["e"], self._e)
        self._steps.append((new, info.get("S")))

    def entries(self, last: Any) -> dict[str, Array]:
        """Return what replaces the entries of the info of the last sample."""
        if np.shape(last.get("e")) != self._e.shape:
            return {}
        S = last.get("S")
        if np.shape(S) != (*self._e.shape, self._e.shape[1]):
            return {"e": self._e}
        for new, of_sample in self._steps:
            rows, columns = new[:, :, None], new[:, None, :]
            S = np.where(rows & columns, of_sample, np.where(rows | columns, 0.0, S))
        return {"e": self._e, "S": S}
