"""The way of the input from the controller to the plant: laws that add to it, alter, hold and delay it, and bounds.

Model   u_c(k) is what the controller returns.  u(k), what acts, is u_c after the laws of `noise.input` in their order,
        then within the bounds of the plant.  A law that omits a sample holds its last one.  A delay of d(j) samples
        lets u_c(j) with the largest j + d(j) <= k act, so that an older command never replaces a newer one.
        u_m(k), what the method knows of u(k), has no law that adds, no holding with `known: false`, and the delay of
        the design model in place of the first delay, or after all laws where there is none.
        A law that remembers its input gets u_c as limited by bounds, rounding and known holding before any delay.
        With feedthrough y(k) depends on u(k), which then must be known before u_c(k).
Start   The input before k = 0 is that of the operating point of the design model, else 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.numerics.linalg import mv
from rmpc_bench.types import Array, KnownDelay, Plant, RunInfo

Stage = Callable[[int, Array], Array]
"""Takes k and the input of all runs, and returns that of the next stage."""


class ActingInput(NamedTuple):
    """The input that acts at k, what the method knows of it, and what a law gets as its last input."""

    u: Float[Array, "runs nu"]
    known: Float[Array, "runs nu"]
    sent: Float[Array, "runs nu"]


class InputChannel:
    """The input of a block of runs, sample by sample; those beyond the bounds of the plant are counted in `runs`.

    `laws` have their random numbers, `delay` is that of the design model, and `before` is empty for 0.
    """

    def __init__(
        self, plant: Plant, laws: Sequence[Any], delay: KnownDelay, before: Sequence[float], runs: RunInfo
    ) -> None:
        self._plant, n_runs = plant, len(runs.alive)
        self._runs: RunInfo | None = runs
        start = np.tile(np.asarray(before or [0.0] * plant.nu), (n_runs, 1))
        self.on_way = [start] * delay.input
        """What a law has sent at k-d..k-1, which acts at k..k+d-1 as far as the method knows."""
        self._laws = _stages(laws, start)
        first = next((i for i, (law, _) in enumerate(laws) if law.longest_delay), len(laws))
        before_delay, after = ([each for each in part if _is_known(each[0])] for part in (laws[:first], laws[first:]))
        constant: list[Stage] = [_Late(np.full((1, 1, 1), float(delay.input)), start)] if delay.input else []
        self._known = [*_stages(before_delay, start), *constant, *_stages(after, start)]
        self._sent = _stages([*before_delay, *(each for each in after if not each[0].omits_measurements)], start)

    def step(self, k: int, u: Float[Array, "runs nu"]) -> ActingInput:
        """Take what the controller returns at k."""
        acting = self._plant.applied_inputs(_through(self._laws, k, u), self._runs)
        if not self._laws and not self.on_way:
            return ActingInput(acting, acting, acting)
        known = self._plant.applied_inputs(_through(self._known, k, u))
        # Without a delay a law gets what the method knows, holding included.
        sent = self._plant.applied_inputs(_through(self._sent, k, u)) if self.on_way else known
        self.on_way = [*self.on_way[1:], sent] if self.on_way else []
        return ActingInput(acting, known, sent)

    def ahead(self, k: int, u: Float[Array, "runs nu"]) -> ActingInput:
        """Return what `step` will return; u has no effect behind a delay of every run."""
        peek = copy(self)
        stages = ([*map(copy, each)] for each in (self._laws, self._known, self._sent))
        peek._runs, (peek._laws, peek._known, peek._sent) = None, stages
        return peek.step(k, u)


def least_delay(laws: Sequence[Any], nu: int) -> int:
    """Return the least delay of any input by laws of the input, in samples."""
    return int(min(sum((law.low * law.chosen for law in laws if law.longest_delay), np.zeros(nu)), default=0))


class Feedthrough:
    """The u(k) on which y(k) depends, before the command of k is known; the estimator gets what it knows of it.

    `signal` gives the inputs in open loop for a number of samples; without it all are late.  After its end a plant has
    the last one, and that of a recorded run is not known.
    """

    def __init__(self, plant: Plant, channel: InputChannel, estimator: Any, signal: Any, n_steps: int) -> None:
        self._plant, self._channel, self._estimator = plant, channel, estimator
        self._is_fed = estimator.fed is not None
        self.acts = plant.feedthrough or self._is_fed
        self._signal = signal(n_steps + 1) if self.acts and signal is not None else None
        self._known = dict[int, Array]()

    def at(self, k: int, n_runs: int) -> list[Array]:
        """Return u(k) for a plant that takes it."""
        if not self.acts:
            return []
        last = k if self._signal is None else self._signal.shape[1] - 1
        given = np.zeros((n_runs, self._plant.nu)) if self._signal is None else self._signal[:, min(k, last)]
        acting = self._channel.ahead(k, given)
        is_known = k <= last or self._plant.feedthrough
        self._known[k] = acting.known if is_known else np.full_like(acting.known, np.nan)
        return [acting.u] if self._plant.feedthrough else []

    def used_by(self, calls: Any) -> Any:
        """Return calls of the estimator with y(k) for one that gets what it needs of u(k)."""
        return FedEstimator(calls, self._estimator, self._known) if self._is_fed else calls


class FedEstimator:
    """The calls of an estimator that gets y(k) - D u(k), or u(k) beside y(k); `known` has u(k) by k, NaN if unknown."""

    def __init__(self, calls: Any, design: Any, known: Any) -> None:
        self._calls, self._design, self._known = calls, design, known

    def __getattr__(self, name: str) -> Any:
        return getattr(self._calls, name)

    def correct(self, k: int, state: Any, y: Array) -> Any:
        """Use y(k); where u(k) is unknown, y(k) counts as missing."""
        u = self._known[k]
        if not self._design.takes_input:
            return self._calls.correct(k, state, y - mv(self._design.fed.at(k).D, u))
        return self._calls.correct(k, state, y + 0.0 * u.sum(axis=1, keepdims=True), np.nan_to_num(u))


def _is_known(law: Any) -> bool:
    """Whether a method knows what a law does to the input; a delay is that of its design model."""
    return bool(law.alters_output and not law.longest_delay and getattr(law, "known", None) is not False)


def _through(stages: Sequence[Stage], k: int, u: Array) -> Array:
    for stage in stages:
        u = stage(k, u)
    return u


def _stages(laws: Sequence[Any], start: Float[Array, "runs nu"]) -> list[Stage]:
    """Return what laws do to the input, each with a memory of its own."""
    return [_stage(law, drawn, start) for law, drawn in laws]


def _stage(law: Any, drawn: Float[Array, "runs samples nu"], start: Float[Array, "runs nu"]) -> Stage:
    if law.longest_delay:
        return _Late(drawn, start)
    return _Held(law, drawn, start) if law.alters_output else partial(_added, drawn)


def _added(drawn: Float[Array, "runs samples nu"], k: int, u: Array) -> Array:
    return u + drawn[:, k]


class _Held:
    """A law that alters the input; its last value is held where a sample is missing."""

    def __init__(self, law: Any, drawn: Array, start: Array) -> None:
        self._law, self._drawn, self._last = law, drawn, start

    def __call__(self, k: int, u: Array) -> Array:
        altered = np.array(self._law.altered(u, self._drawn[:, k]))
        self._last = np.where(np.isnan(altered), self._last, altered)
        return self._last


class _Late:
    """A delay: the newest input that has arrived."""

    def __init__(self, d: Float[Array, "_ samples _"], start: Array) -> None:
        self._start, n_runs, nu = start, *start.shape
        self._depth = int(d.max(initial=0.0)) + 1
        self._past = np.empty((self._depth, n_runs, nu))
        self._newest = newest(d.astype(int)) if d.shape[1] > 1 else None
        self._places = np.arange(n_runs)[:, None], np.arange(nu)[None]

    def __call__(self, k: int, u: Array) -> Array:
        self._past[k % self._depth] = u
        j = np.full((1, 1), k - self._depth + 1) if self._newest is None else self._newest[:, k]
        return np.where(j < 0, self._start, self._past[(j % self._depth, *self._places)])


def newest(d: Int[Array, "runs samples n"]) -> Int[Array, "runs samples n"]:
    """Return, for every k, the largest j with j + d(j) <= k; -1 where nothing has arrived."""
    n_samples = d.shape[1]
    arrives = np.arange(n_samples)[None, :, None] + d
    row, j, i = np.nonzero(arrives < n_samples)
    found = np.full(d.shape, -1)
    np.maximum.at(found, (row, arrives[row, j, i], i), j)
    return np.maximum.accumulate(found, axis=1)
