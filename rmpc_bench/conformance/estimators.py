"""Checks of estimators: shapes, purity, and runs that do not depend on the block they share."""

from __future__ import annotations

from typing import Any

import numpy as np

from rmpc_bench.conformance.failures import require_valid_return_values
from rmpc_bench.conformance.filtering import EstimatorExample
from rmpc_bench.conformance.outcome import REPETITION, first_checks, refuse_objects
from rmpc_bench.conformance.results import Check, copies, require, require_same, require_unchanged
from rmpc_bench.types import Array, Estimator, as_estimate


def _base_class(estimator: Any, _: EstimatorExample) -> None:
    require(isinstance(estimator, Estimator), f"{type(estimator).__name__} is not a subclass of Estimator")


def _shapes(estimator: Estimator, example: EstimatorExample) -> None:
    outcome = example.all(estimator)
    require_valid_return_values(outcome.journal, "shape")
    n_runs, nx = outcome.returned[0].x_hat.shape
    require(n_runs == example.n_runs, f"x_hat has {n_runs} rows for {example.n_runs} runs")
    require(example.nx in (None, nx), f"x_hat has {nx} numbers; the model has {example.nx} states")
    for state in outcome.states if not estimator.starts_runs else []:
        require(all(len(array) == n_runs for array in state), "axis 0 of a state's array is not the run")
    for k, estimate in enumerate(outcome.returned):
        require(estimate.x_hat.shape == (n_runs, nx), f"x_hat has shape {estimate.x_hat.shape} at k = {k}")
        require(estimate.x_hat.dtype == np.float64, f"x_hat is {estimate.x_hat.dtype}, not float64")
        for name, matrix in (("P", estimate.P), ("M", estimate.M)):
            fits = matrix is None or matrix.shape in ((nx, nx), (n_runs, nx, nx))
            require(fits, f"{name} has shape {None if matrix is None else matrix.shape}")
        require(estimate.status.dtype == np.int8, f"status is {estimate.status.dtype}, not int8")
        require(estimate.status.shape == (n_runs,), f"status has shape {estimate.status.shape} for {n_runs} runs")
        for name, values in estimate.info.items():
            require(len(values) == n_runs, f"info[{name!r}] has {len(values)} rows for {n_runs} runs")


def _arguments(estimator: Estimator, example: EstimatorExample) -> None:
    state = example.start(estimator, range(example.n_runs))
    refuse_objects(estimator, state)
    for k in range(3):
        arguments = [*state, example.y, example.u]
        before = copies(arguments)
        corrected, _ = estimator.correct(k, state, example.y[:, k])
        require_unchanged(arguments, before)
        arguments = [*corrected, example.y, example.u]
        before = copies(arguments)
        state = estimator.predict(k, corrected, example.u[:, k])
        require_unchanged(arguments, before)


def _purity(estimator: Estimator, example: EstimatorExample) -> None:
    state = example.start(estimator, range(example.n_runs))
    refuse_objects(estimator, state)
    for k in range(3):
        (a, first), (b, second) = (estimator.correct(k, state, example.y[:, k]) for _ in range(2))
        require_same("x_hat", as_estimate(second).x_hat, as_estimate(first).x_hat)
        new, again = (estimator.predict(k, each, example.u[:, k]) for each in (a, b))
        for number, (left, right) in enumerate(zip(new, again, strict=True)):
            require_same(f"state[{number}]", right, left)
        state = new


def _own_arrays(estimator: Estimator, example: EstimatorExample) -> None:
    state = example.start(estimator, range(example.n_runs))
    refuse_objects(estimator, state)
    returned: list[Array] = []
    for k in range(3):
        state, corrected = estimator.correct(k, state, example.y[:, k])
        estimate = as_estimate(corrected)
        returned += [each for each in (estimate.x_hat, estimate.P) if each is not None and each.ndim in (2, 3)]
        before = copies(returned)
        state = estimator.predict(k, state, example.u[:, k])
        estimator.correct(k + 1, state, example.y[:, k + 1])
        changed = not all(np.array_equal(*pair, equal_nan=True) for pair in zip(returned, before, strict=True))
        require(not changed, "a later call changes an array that was returned before; return a new array")


def _missing(estimator: Estimator, example: EstimatorExample) -> None:
    run, k, broken = example.n_runs // 2, 3, example.y.copy()
    broken[run, k] = np.nan
    outcome, expected = example.evaluate(estimator, y=broken), example.x_hat(estimator)
    found = outcome.values
    require_same("x_hat of the other runs", np.delete(found, run, axis=0), np.delete(expected, run, axis=0))
    require_same("x_hat before the missing sample", found[run, :k], expected[run, :k])
    # The estimate of a predictor uses y(k) one sample later.
    if estimator.bridges_missing:
        require(bool(np.isfinite(found).all()), "x_hat is not finite after a missing measurement")
        changed = (found[run, k : k + 2] != expected[run, k : k + 2]).any()
        require(bool(changed), "x_hat does not depend on the measurement")
    else:
        failed = bool(outcome.status[run]) or bool(np.isnan(found[run, k : k + 2]).any())
        require(
            failed,
            "x_hat is finite although a measurement is missing; set `bridges_missing` if the estimator then predicts",
        )


def _series(estimator: Estimator, example: EstimatorExample) -> None:
    for name, values in estimator.series().items():
        fits = len(values) in (1, example.y.shape[1])
        require(fits, f"series {name!r} has {len(values)} entries for {example.y.shape[1]} samples")


FIRST = first_checks(
    Check("base-class", "the estimator is a subclass of Estimator", _base_class, is_first=True),
    _shapes,
    "axis 0 is the run; P and M are shared, per run or None; numbers are float64",
)
EstimatorExample.checks = (
    *FIRST,
    Check("arguments", "correct and predict leave their arguments unchanged", _arguments),
    Check("own-arrays", "an array that was returned does not change later", _own_arrays, "warning"),
    Check("purity", "the same call twice gives the same bits", _purity),
    *REPETITION,
    Check("missing-measurement", "a missing measurement of one run changes no other run", _missing),
    Check("series", "a series has one entry for every sample, or a single constant one", _series),
)
