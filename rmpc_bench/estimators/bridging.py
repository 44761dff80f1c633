"""Gains of runs in which measurements are missing (NaN), from the recursion of the covariances of each run.

Model   Outputs that are missing at k are left out of the correction at k: the design has then only the outputs that are
        there.  From the first gap on, gains and covariances of a run come from the recursion of its filter; the other
        runs keep the precomputed ones.  Without any output a filter predicts only.
Fails   A run gets status `infeasible` where its recursion has no solution.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import NoiseSets
from rmpc_bench.numerics.divergence import Inflation
from rmpc_bench.numerics.mixed_step import MixedStep, Prior, Rule, mixed_step, root_weight, sum_root
from rmpc_bench.numerics.riccati import predicted_root
from rmpc_bench.numerics.square_root import corrected, covariance_of, root_of, without_missing
from rmpc_bench.types import Array, DesignError


class BridgingState(NamedTuple):
    """State between steps of a filter that bridges missing measurements."""

    x_pred: Float[Array, "runs nx"]
    e: Float[Array, "runs ny"]  # innovation of the last correction; 0 of a run with gains of its own
    own: Bool[Array, " runs"]  # whether a measurement of the run has been missing, so that it has gains of its own
    kept: Float[Array, "runs ..."]  # what their recursion keeps of these runs; not used for others
    shift: Float[Array, "runs nx"]  # K e of these runs, with the change of F x_pred where they have an F of their own


class Gains(NamedTuple):
    """Gains and covariances at k of some runs; None where a filter has none, or those of the schedule hold."""

    L: Float[Array, "own nx ny"]
    K: Float[Array, "own nx ny"]
    kept: Float[Array, "own ..."]  # what the step at k+1 needs, such as the root of P_pred
    P: Float[Array, "own nx nx"] | None
    S: Float[Array, "own ny ny"] | None = None
    F: Float[Array, "own nx nx"] | None = None
    M: Float[Array, "own nx nx"] | None = None


Recursion: TypeAlias = Callable[[int, Array, Array], Gains]
"""Maps k, what the runs have kept and their missing outputs (own, ny) to their gains."""


class Outputs(NamedTuple):
    """A linear model with those of its outputs that are there."""

    A: Float[Array, "nx nx"]
    C: Float[Array, "ny nx"]
    Q_w: Float[Array, "nx nx"]
    R_v: Float[Array, "ny ny"]

    @classmethod
    def of(cls, now: LinearModel, there: Bool[Array, " all"]) -> Outputs:
        """Leave the other outputs out."""
        C, R_v = with_outputs(now.C, now.R_v, there)
        return cls(now.A, C, now.Q_w, R_v)


def with_outputs(
    M: Float[Array, "nz nx"], J: Float[Array, "nz nz"], there: Bool[Array, " ny"]
) -> tuple[Float[Array, "fewer nx"], Float[Array, "fewer fewer"]]:
    """Return [A; C], or C, and the covariance of its noises with those of the outputs that are there."""
    rows = np.concatenate([np.ones(len(M) - len(there), dtype=bool), there])
    return M[rows], J[np.ix_(rows, rows)]


@dataclass(frozen=True, eq=False)
class RiccatiRecursion:
    """The recursion of `riccati_schedule` for all runs at once; P is that of a corrected estimate if it `corrects`."""

    models: Sequence[LinearModel]
    inflate: Callable[[int, Array], Inflation] | None = None
    corrects: bool = True
    use_y0: bool = True
    growth: float = 1.0

    def __call__(self, k: int, kept: Array, missing: Array) -> Gains:
        """Return the gains at k."""
        now = self.models[min(k, len(self.models) - 1)]
        V = kept if self.inflate is None else np.array([self._inflated(k, each) for each in kept])
        if k == 0 and not self.use_y0:
            L, root = np.zeros((len(V), *now.C.T.shape)), V
        else:
            # A missing output becomes one that does not depend on the state.
            R_root = root_of(without_missing(now.R_v, ~missing))
            found = corrected(np.where(missing[:, :, None], 0.0, now.C), R_root, V)
            L, root = found.gain, found.root
        kept, S = predicted_root(now.A, now.Q_w, root, self.growth), covariance_of(now.C @ V) + now.R_v
        return Gains(L, now.A @ L, kept, covariance_of(root if self.corrects else V), S)

    def _inflated(self, k: int, root: Array) -> Array:
        assert self.inflate is not None
        try:
            return self.inflate(k, root).root
        except DesignError:  # no V: nothing is inflated at this sample
            return root
        except np.linalg.LinAlgError:
            return np.full_like(root, np.nan)


@dataclass(frozen=True, eq=False)
class RunByRun:
    """A recursion that computes one run at a time, for k, what it has kept, and which outputs are there.

    The gains are those of these outputs.  A ValueError or a DesignError says that there are none.
    """

    one: Callable[[int, Array, Array], Gains]

    def __call__(self, k: int, kept: Array, missing: Array) -> Gains:
        """Return the gains at k; NaN where there are none."""
        found = [self._of(k, *each) for each in zip(kept, ~missing, strict=True)]
        return Gains(*(_stacked(each) for each in zip(*found, strict=True)))  # type: ignore[arg-type]

    def _of(self, k: int, kept: Array, there: Array) -> Gains:
        L, K = (np.zeros((kept.shape[-1], len(there))) for _ in range(2))
        try:
            found = self.one(k, kept, there)
        except (DesignError, ValueError):
            return Gains(L * np.nan, K * np.nan, kept * np.nan, None)
        L[:, there], K[:, there] = found.L, found.K
        return found._replace(L=L, K=K)


def _stacked(matrices: Sequence[Array | None]) -> Array | None:
    """Return the matrices of all runs, NaN for runs without one; None where there is none at all."""
    some = next((each for each in matrices if each is not None), None)
    if some is None:
        return None
    return np.array([np.full_like(some, np.nan) if each is None else each for each in matrices])


@dataclass(frozen=True, eq=False)
class MixedRecursion:
    """The recursion of `mixed_schedule`; it keeps the roots of P_pred and M_pred, and the last weight q as a matrix."""

    models: Sequence[LinearModel]
    sets: NoiseSets
    rule: Rule
    use_y0: bool
    counted: float  # factor of the stochastic noises, 0 or 1

    def step(self, k: int, kept: Array, there: Any = slice(None)) -> tuple[MixedStep, Array, float]:
        """Return the correction with some outputs, what is kept for k+1, and the weight p of the prediction."""
        now, (P, M, q) = self.models[k], kept
        R, M_v = (matrix[there][:, there] for matrix in (now.R_v, self.sets.measurement(k)))
        prior = Prior(now.C[there], P, M, self.counted * root_of(R), root_of(M_v))
        measured = len(R) > 0 and (k > 0 or self.use_y0)
        step = mixed_step(prior, self.rule, float(q[0, 0])) if measured else prior.kept()
        moved, noise = now.A.dot(step.M_root), root_of(self.sets.process(k))
        p = root_weight(moved, noise)  # (23)
        P = predicted_root(now.A, self.counted * now.Q_w, step.P_root)  # (17)
        q_next = np.full_like(P, step.q if step.q < inf else 1.0)  # as `mixed_step` starts without a last weight
        return step, np.array([P, sum_root(moved, noise, p), q_next]), p  # (18)

    def gains(self, k: int, kept: Array, there: Array) -> Gains:
        """Return the gains of a run."""
        step, after, _ = self.step(k, kept, there)
        return Gains(step.L, self.models[k].A.dot(step.L), after, step.P, M=step.M)
