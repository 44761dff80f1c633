"""Checks of the information that x_hat(k) depends on: y(0)..y(k), u(0)..u(k-1) and the model, and nothing else.

They need a linear Gaussian system (`linear_system`), whose best estimator is the Kalman filter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.components.designs import estimator as made_estimator
from rmpc_bench.conformance.consistency import consistency_text
from rmpc_bench.conformance.filtering import EstimatorExample
from rmpc_bench.conformance.linear_system import LinearSystem, Recorded
from rmpc_bench.conformance.results import (
    Check,
    NotApplicableError,
    Returned,
    first_difference,
    require,
)
from rmpc_bench.conformance.timing import exactness, shift_text
from rmpc_bench.types import Array, Estimator

CHANGE = 81
"""Sample from which on another y is given to a causal estimator."""
AHEAD = 20
"""Samples after the change; a component that looks further ahead is not found."""
MOST_ERRORS = 4.0
"""Standard errors beyond which a paired difference counts."""

LOST = 0.4
"""Probability that an output of a sample is missing."""
EQUAL, STILL_EQUAL = 1e-5, 1e-4
"""Largest difference from the Kalman filter, relative to its largest estimate, without and with missing outputs."""


class EstimatorData(NamedTuple):
    """Everything that an estimator may use of some runs."""

    y: Float[Array, "runs samples ny"]
    u: Float[Array, "runs steps nu"]

    def results(self, estimator: Estimator) -> Float[Array, "runs samples nx"]:
        """Return the estimates."""
        return EstimatorExample(self.y, self.u).x_hat(estimator)


@dataclass(frozen=True, eq=False)
class EstimatorInformationExample:
    """A linear Gaussian system that an estimator is checked on.

    Parameters
    ----------
    system : the system with the random inputs of its runs
    separate_process : repeats the filter in a process without a plant; takes the data and whether the environment
        (hash seed, working directory) is the same as here; None where there are no other processes
    """

    system: LinearSystem
    separate_process: Callable[[EstimatorData, bool], Returned] | None = None
    checks: ClassVar[tuple[Check, ...]]
    noun: ClassVar[str] = "x_hat"

    @cached_property
    def recorded(self) -> Recorded:
        """Data with noise."""
        return self.system.recorded()

    @cached_property
    def data(self) -> EstimatorExample:
        """The measurements and inputs alone."""
        return EstimatorExample(self.recorded.y, self.recorded.u, nx=self.system.model.nx)

    @cached_property
    def kalman(self) -> Float[Array, "runs samples nx"]:
        """Estimates of the Kalman filter."""
        return self.data.x_hat(self.system.kalman)

    @cached_property
    def _loops(self) -> dict[int, tuple[Estimator, Array]]:
        return {}

    def in_loop(self, estimator: Estimator) -> Float[Array, "runs samples nx"]:
        """Estimates in the simulation, where there is a plant; computed once per estimator."""
        if id(estimator) not in self._loops:
            record, _ = self.system.simulated(estimator)
            self._loops[id(estimator)] = estimator, record.x_hat
        return self._loops[id(estimator)][1]

    def away(self, *, same: bool) -> Returned:
        """Estimates in a process without a plant."""
        if self.separate_process is None:
            raise NotApplicableError("needs another process")
        return self.separate_process(EstimatorData(self.recorded.y, self.recorded.u), same)


def _agrees(result: Returned, expected: Array) -> bool:
    return result.values is not None and np.array_equal(result.values, expected, equal_nan=True)


def _difference(result: Returned, expected: Array, name: str) -> str:
    if result.values is None:
        return result.raised
    if result.values.shape != expected.shape:
        return f"{name} has shape {result.values.shape} instead of {expected.shape}"
    place = first_difference(result.values, expected)
    differing = int((result.values != expected).any(axis=(1, 2)).sum())
    return f"{name} of run {place[0]} differs from k = {place[1]} on, that of {differing} of {len(expected)} runs"


def function_of_data(component: Any, example: Any) -> None:
    """Fail if the component returns other values without a plant in the same environment."""
    loop = example.in_loop(component)
    if _agrees(example.away(same=False), loop):
        return
    same = example.away(same=True)
    if _agrees(same, loop):
        return
    differs = _difference(same, loop, example.noun)
    raise AssertionError(f"in a process without a plant {differs}: it uses more than its arguments, such as the plant")


def fresh_process(component: Any, example: Any) -> None:
    """Fail if the component returns other values with another hash seed and another working directory."""
    loop, other = example.in_loop(component), example.away(same=False)
    if _agrees(other, loop):
        return
    if not _agrees(example.away(same=True), loop):
        raise NotApplicableError("see `function-of-data`")
    differs = _difference(other, loop, "the result")
    raise AssertionError(f"with another PYTHONHASHSEED and working directory {differs}; does it iterate over a set?")


def _causal(estimator: Estimator, example: EstimatorInformationExample) -> None:
    require_causal(estimator, example.data)


def require_causal(estimator: Estimator, data: EstimatorExample, change: int = CHANGE) -> None:
    """Fail if estimates before `change` depend on y from there on; the error says how far they look ahead."""
    y, rows = data.y[:5, : change + AHEAD], range(min(5, data.n_runs))
    changed = y.copy()
    # The size of noise: measurements of another size may be impossible for the model.
    spread = 0.5 * np.diff(y, axis=1).std(axis=(0, 1)) + 1e-6 * np.abs(y).max()
    changed[:, change:] += spread * np.random.default_rng(17).standard_normal(changed[:, change:].shape)
    # Several times each: an estimator may remember the data of an earlier method and use them as the future.
    before, after = ([data.x_hat(estimator, rows, each) for _ in range(3)] for each in (y, changed))
    if not np.array_equal(before[1][:, :change], before[2][:, :change], equal_nan=True):
        raise NotApplicableError("the same data give other numbers, see `repeated`")
    for other in after:
        found, expected = other[:, :change], before[2][:, :change]
        differs = (found != expected) & ~((found != found) & (expected != expected))
        if differs.any():
            ahead = change - int(np.flatnonzero(differs.any(axis=(0, 2)))[0])
            samples = f"{ahead} sample{'s' if ahead > 1 else ''}"
            raise AssertionError(f"uses the future: with another y from k = {change} on x_hat changes {samples} ahead")


def _in_time(estimator: Estimator, example: EstimatorInformationExample) -> str:
    return shift_text(example.in_loop(estimator), example.recorded.x)


def _applied(estimator: Estimator, example: EstimatorInformationExample) -> None:
    if not np.array_equal(example.data.all(estimator).values, example.in_loop(estimator), equal_nan=True):
        raise NotApplicableError("see `function-of-data`")
    u = example.system.u
    system = replace(example.system, largest=0.5 * float(np.abs(u).max(initial=0.0)) or 1.0)
    record, _ = system.simulated(estimator)
    recorded = system.recorded()
    expected = EstimatorExample(recorded.y, np.clip(u, -system.largest, system.largest)).x_hat(estimator)
    require(
        np.allclose(record.x_hat, expected, rtol=1e-9, atol=1e-12, equal_nan=True),
        "where the plant limits the input, x_hat is not that of the input that acts: use the u that `predict` gets",
    )


def _exact(estimator: Estimator, example: EstimatorInformationExample) -> str:
    return exactness(estimator, example.system)


def _consistent(estimator: Estimator, example: EstimatorInformationExample) -> str:
    outcome = example.data.all(estimator)
    matrices = [estimate.P for estimate in outcome.returned]
    if any(P is None for P in matrices):
        raise NotApplicableError("P is not reported")
    predictor = estimator.form == "predictor"
    P = np.stack(matrices, axis=matrices[0].ndim - 2)
    return consistency_text(example.system.model, example.recorded, outcome.values, P, predictor=predictor)


def _possible(estimator: Estimator, example: EstimatorInformationExample) -> str:
    x = example.recorded.x
    found, best = (
        ((x_hat - x)[:, 5:] ** 2).mean(axis=(1, 2)) for x_hat in (example.in_loop(estimator), example.kalman)
    )
    tiny = np.finfo(float).tiny
    log_ratio = 0.5 * np.log(np.maximum(found, tiny) / np.maximum(best, tiny))
    mean, error = float(log_ratio.mean()), float(log_ratio.std(ddof=1) / np.sqrt(len(x)))
    text = f"error {np.exp(mean):.3g} times that of the Kalman filter"
    require(
        not (mean < -MOST_ERRORS * error and mean < -1e-6),
        f"{text}, {-mean / max(error, tiny):.0f} standard errors below it: it uses the true state or later measurements"
        if error > 0.0
        else f"{text} in every run",
    )
    return text


def _kalman_with_gaps(estimator: Estimator, example: EstimatorInformationExample) -> str:
    if not estimator.bridges_missing:
        raise NotApplicableError("the estimator does not go on without a measurement")
    system, rows = example.system, range(6)
    y = example.data.y[:, :61]
    lost = np.random.default_rng(19).random(y.shape) < LOST
    lost[0] = False  # a run without gaps beside the others
    for form in ("filter", "predictor"):
        kalman = made_estimator("kalman", system.model, system.n_steps, x0=system.x0, P0=system.P0, form=form)
        whole, gaps = (
            _distance(*(example.data.x_hat(each, rows, values) for each in (estimator, kalman)))
            for values in (y, np.where(lost, np.nan, y))
        )
        if whole <= EQUAL:
            text = f"differs by {gaps:.2g} of the largest estimate with missing measurements, by {whole:.2g} without"
            way = "compute the gains again where measurements are missing, or set bridges_missing = False"
            require(
                gaps <= STILL_EQUAL,
                f"{text}: does it keep the gains of a run in which nothing is missing? {way}",
            )
            return text
    raise NotApplicableError("with these keys it is not the Kalman filter; give the keys with which it is")


def _distance(found: Array, expected: Array) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max())


FUNCTION = Check(
    "function-of-data", "x_hat depends on y, u and the model only: the same without a plant", function_of_data
)
FRESH = Check("fresh-process", "the same bits in a fresh process, with another hash seed and directory", fresh_process)
EstimatorInformationExample.checks = (
    FUNCTION,
    FRESH,
    Check("causal", "x_hat(k) does not depend on y after k", _causal),
    Check("in-time", "x_hat(k) fits x(k) better than the state of any other sample", _in_time),
    Check("applied-input", "predict uses the input that acts, within the bounds of the plant", _applied),
    Check("exact", "without noise and from the true x(0), x_hat is the state", _exact),
    Check("possible", "the error is not smaller than that of the Kalman filter, which is optimal here", _possible),
    Check(
        "kalman-with-gaps",
        "an estimator that equals the Kalman filter with all measurements also does where some are missing",
        _kalman_with_gaps,
    ),
    Check("consistent", "errors and innovations agree with the reported covariance P", _consistent, "warning"),
)
