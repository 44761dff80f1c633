"""The sets that an estimator believes errors and noises to lie in, or the covariances that stand for them.

Sets    the bounded part of a noise lies in E(0, M) of a model that knows sets; its stochastic part, N(0, P), in the
        ellipsoid E(0, c P) that holds it with some confidence; their sum in the ellipsoid of least trace around both.
Source  ma2025, (9), (10), (18); the confidence ellipsoids and matched moments are readings of Section V.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel, Model
from rmpc_bench.numerics.ellipsoid import confidence, sum_shape
from rmpc_bench.types import Array, HasSets

LEVEL = 0.95
"""Confidence of the ellipsoid that stands for a covariance where somebody asks for a set."""


@dataclass(frozen=True, eq=False)
class NoiseSets:
    """The sets that an estimator believes the noises to lie in.

    Parameters
    ----------
    model : what the estimator believes; one that knows no sets has M = 0
    level : confidence of the ellipsoid that stands for the stochastic noise; None leaves that noise out
    bounded : whether the bounded noise counts
    """

    model: Model
    level: float | None = None
    bounded: bool = True

    def process(self, k: int) -> Float[Array, "nx nx"]:
        """Shape of the set of the process noise at k."""
        now = self.model.at(k)
        return self._set(now.Q_w, self.model.M_w(k) if isinstance(self.model, HasSets) else np.zeros_like(now.Q_w))

    def measurement(self, k: int) -> Float[Array, "ny ny"]:
        """Shape of the set of the measurement noise at k."""
        now = self.model.at(k)
        return self._set(now.R_v, self.model.M_v(k) if isinstance(self.model, HasSets) else np.zeros_like(now.R_v))

    def initial(self, P0: Float[Array, "nx nx"], M0: Float[Array, "nx nx"]) -> Float[Array, "nx nx"]:
        """Shape of the set of x(0) - x0, whose parts have the covariance P0 and the set M0."""
        return self._set(P0, M0)

    def _set(self, P: Array, M: Array) -> Array:
        M = M if self.bounded else np.zeros_like(M)
        return M if self.level is None else sum_shape(M, confidence(self.level, len(P)) * P)


NoiseKind: TypeAlias = Literal["nominal", "matched"]


@dataclass(frozen=True, eq=False)
class MatchedModel:
    """A model whose covariances count bounded noises as uniform ones on their ellipsoids."""

    model: Model

    def at(self, k: int) -> LinearModel:
        """The model at k: Q_w + M_w / (nx + 2), R_v + M_v / (ny + 2)."""
        now, sets = self.model.at(k), NoiseSets(self.model)
        M_w, M_v = sets.process(k), sets.measurement(k)
        if not (M_w.any() or M_v.any()):
            return now
        Q_w, R_v = now.Q_w + uniform_covariance(M_w), now.R_v + uniform_covariance(M_v)
        return LinearModel(now.A, now.B, now.C, Q_w, R_v, S_wv=now.S_wv, f0=now.f0, d0=now.d0)


def uniform_covariance(M: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return the covariance of the uniform law on E(0, M)."""
    cov: Array = M / (len(M) + 2)
    return cov


def with_noise_kind(
    model: Model, P0: Float[Array, "nx nx"], M0: Float[Array, "nx nx"] | None, noise: NoiseKind
) -> tuple[Model, Float[Array, "nx nx"]]:
    """Return a model and an initial covariance that count what is bounded as uniform, if `matched`, or leave it out."""
    if noise == "nominal":
        return model, P0
    return MatchedModel(model), P0 if M0 is None else P0 + uniform_covariance(M0)


@runtime_checkable
class BelievesSets(Protocol):
    """An estimator that says in which sets its error and the noises lie, or with which covariance."""

    @property
    def P(self) -> Float[Array, "k nx nx"] | None:
        """Covariance of x_hat - x over k, None where nothing is said of it before any data."""

    @property
    def M(self) -> Float[Array, "k nx nx"] | None:
        """Shape of the set of x_hat - x over k, None where nothing is said of it before any data."""

    @property
    def sets(self) -> NoiseSets | None:
        """Sets of the noises, None where it has those of its model."""


def stochastic_sets(model: Model) -> NoiseSets:
    """The confidence ellipsoids of the covariances of a model, for who asks for sets and gets none."""
    return NoiseSets(model, LEVEL, bounded=False)
