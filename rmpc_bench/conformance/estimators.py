"""Checks of estimators: shapes, purity, and runs that do not depend on the block they share."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.results import Check, copies, require, require_frozen, require_same, require_unchanged
from rmpc_bench.types import Array, Estimate, Estimator, Status


@dataclass(frozen=True, eq=False)
class EstimatorExample:
    """Measurements and inputs that an estimator is checked with.

    Parameters
    ----------
    y : (runs, samples, ny) measurements of at least six runs and four samples; the design must know as many samples
    u : (runs, samples, nu) inputs
    delta : for an oracle estimator: the plant's record of uncertain parameters for the runs of the given indices
    """

    y: Float[Array, "runs samples ny"]
    u: Float[Array, "runs samples nu"]
    delta: Callable[[Sequence[int]], Any] | None = None
    checks: ClassVar[tuple[Check, ...]]

    @classmethod
    def random(
        cls, nu: int, ny: int, *, n_runs: int = 9, n_steps: int = 12, seed: int = 11, delta: Any = None
    ) -> EstimatorExample:
        """Draw standard normal measurements and inputs.

        Parameters
        ----------
        nu, ny : number of inputs and outputs
        n_runs, n_steps : size of the example; there are n_steps + 1 samples
        seed : of the generator
        delta : as above
        """
        rng = np.random.default_rng(seed)
        y, u = (rng.standard_normal((n_runs, n_steps + 1, n)) for n in (ny, nu))
        return cls(y, u, delta)

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.y)

    def start(self, estimator: Estimator, rows: Sequence[int]) -> Any:
        """State of some runs before the first measurement."""
        if not estimator.knows_uncertainty:
            return estimator.init(len(rows))
        require(self.delta is not None, "the estimator knows the uncertain parameters; give the example `delta`")
        init: Any = estimator.init
        return init(len(rows), self.delta(rows) if self.delta is not None else None)

    def filtered(
        self, estimator: Estimator, rows: Sequence[int] | None = None, y: Array | None = None
    ) -> tuple[list[Any], list[Estimate]]:
        """States and estimates of some runs over time."""
        rows = range(self.n_runs) if rows is None else rows
        y = self.y if y is None else y
        state, states, estimates = self.start(estimator, rows), [], []
        for k in range(y.shape[1]):
            state, estimate = estimator.correct(k, state, np.ascontiguousarray(y[rows, k]))
            states.append(state)
            estimates.append(estimate)
            state = estimator.predict(k, state, np.ascontiguousarray(self.u[rows, k]))
            states.append(state)
        return states, estimates

    def x_hat(
        self, estimator: Estimator, rows: Sequence[int] | None = None, y: Array | None = None
    ) -> Float[Array, "runs samples nx"]:
        """Estimates of some runs over time."""
        return np.stack([estimate.x_hat for estimate in self.filtered(estimator, rows, y)[1]], axis=1)


def _base_class(estimator: Any, _: EstimatorExample) -> None:
    require(isinstance(estimator, Estimator), f"{type(estimator).__name__} is not a subclass of Estimator")
    require_frozen(estimator)


def _shapes(estimator: Estimator, example: EstimatorExample) -> None:
    states, estimates = example.filtered(estimator)
    n_runs, nx = estimates[0].x_hat.shape
    require(n_runs == example.n_runs, f"x_hat has {n_runs} rows for {example.n_runs} runs")
    for state in states:
        require(all(len(array) == n_runs for array in state), "axis 0 of a state's array is not the run")
    for estimate in estimates:
        require(estimate.x_hat.shape == (n_runs, nx), f"x_hat has shape {estimate.x_hat.shape}")
        require(estimate.x_hat.dtype == np.float64, f"x_hat is {estimate.x_hat.dtype}, not float64")
        for name, matrix in (("P", estimate.P), ("M", estimate.M)):
            fits = matrix is None or matrix.shape in ((nx, nx), (n_runs, nx, nx))
            require(fits, f"{name} has shape {None if matrix is None else matrix.shape}")
        require(estimate.status.dtype == np.int8, f"status is {estimate.status.dtype}, not int8")
        require_same("status", estimate.status, np.full(n_runs, Status.OK, dtype=np.int8))
        for name, values in estimate.info.items():
            require(len(values) == n_runs, f"info[{name!r}] has {len(values)} rows for {n_runs} runs")


def _arguments(estimator: Estimator, example: EstimatorExample) -> None:
    state = example.start(estimator, range(example.n_runs))
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
    for k in range(3):
        (a, first), (b, second) = (estimator.correct(k, state, example.y[:, k]) for _ in range(2))
        require_same("x_hat", second.x_hat, first.x_hat)
        new, again = (estimator.predict(k, each, example.u[:, k]) for each in (a, b))
        for number, (left, right) in enumerate(zip(new, again, strict=True)):
            require_same(f"state[{number}]", right, left)
        state = new


def _alone(estimator: Estimator, example: EstimatorExample) -> None:
    together = example.x_hat(estimator)
    for run in range(example.n_runs):
        require_same(f"x_hat of run {run} alone", example.x_hat(estimator, [run]), together[run : run + 1])


def _order(estimator: Estimator, example: EstimatorExample) -> None:
    order = np.random.default_rng(5).permutation(example.n_runs).tolist()
    require_same("x_hat in another order", example.x_hat(estimator, order), example.x_hat(estimator)[order])


def _pickle(estimator: Estimator, example: EstimatorExample) -> None:
    copy = pickle.loads(pickle.dumps(estimator))
    require_same("x_hat of the copy", example.x_hat(copy), example.x_hat(estimator))


def _missing(estimator: Estimator, example: EstimatorExample) -> None:
    run, k, broken = example.n_runs // 2, 3, example.y.copy()
    broken[run, k] = np.nan
    found, expected = example.x_hat(estimator, y=broken), example.x_hat(estimator)
    require_same("x_hat of the other runs", np.delete(found, run, axis=0), np.delete(expected, run, axis=0))
    require_same("x_hat before the missing sample", found[run, :k], expected[run, :k])
    if estimator.bridges_missing:
        require(bool(np.isfinite(found).all()), "x_hat is not finite after a missing measurement")
        require(bool((found[run, k] != expected[run, k]).any()), "x_hat does not depend on the measurement")
    else:  # the estimate of a predictor uses y(k) one sample later
        require(bool(np.isnan(found[run, k : k + 2]).any()), "x_hat hides a missing measurement")


def _series(estimator: Estimator, example: EstimatorExample) -> None:
    for name, values in estimator.series().items():
        fits = len(values) in (1, example.y.shape[1])
        require(fits, f"series {name!r} has {len(values)} entries for {example.y.shape[1]} samples")


EstimatorExample.checks = (
    Check("base-class", "the estimator is a frozen subclass of Estimator", _base_class),
    Check("shapes", "axis 0 is the run; P and M are shared, per run or None; status is int8", _shapes),
    Check("arguments", "correct and predict leave their arguments unchanged", _arguments),
    Check("purity", "the same call twice gives the same bits", _purity),
    Check("batch-independence", "a run gives the same bits alone and inside any block", _alone),
    Check("order", "permuting the runs permutes the estimates, bit for bit", _order),
    Check("pickle", "a copy made by pickle gives the same bits", _pickle),
    Check("missing-measurement", "a missing measurement of one run changes no other run", _missing),
    Check("series", "a series has one entry for every sample, or a single constant one", _series),
)
