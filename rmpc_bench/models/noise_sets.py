"""Sets and covariances that a design assumes for errors and noises, and covariances that represent sets.

Sets    The set E(0, M) contains the bounded part of a noise, if the model has sets.  The confidence ellipsoid E(0, c P)
        contains the stochastic part N(0, P) with a given probability.  The outer ellipsoid of least trace contains
        their sum.
Source  ma2025, (9), (10), (18); the confidence ellipsoids and matched moments are interpretations of Section V.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.ellipsoid import confidence, sum_shape
from rmpc_bench.numerics.linalg import as_covariance, van_loan
from rmpc_bench.types import Array, DesignError, Matrix, Model, NonNegative

LEVEL = 0.95
"""Probability of the confidence ellipsoid that represents a covariance where a method needs a set."""


@dataclass(frozen=True, eq=False)
class NoiseSets:
    """The sets that a design assumes for the noises."""

    model: Model  # M = 0 if it has no sets
    level: float | None = None  # probability of the ellipsoid of the stochastic noise; None omits that noise
    bounded: bool = True  # whether to include the bounded noise

    def process(self, k: int) -> Float[Array, "nx nx"]:
        """Return the shape matrix of the set of the process noise at k."""
        now = self.model.at(k)
        return self.of_parts(now.Q_w, self.model.M_w(k))

    def measurement(self, k: int) -> Float[Array, "ny ny"]:
        """Return the shape matrix of the set of the measurement noise at k."""
        now = self.model.at(k)
        return self.of_parts(now.R_v, self.model.M_v(k))

    def of_parts(self, P: Float[Array, "n n"], M: Float[Array, "n n"]) -> Float[Array, "n n"]:
        """Return the shape matrix of the set of a sum of parts with covariance P and set M, such as x(0) - x0."""
        M = M if self.bounded else np.zeros_like(M)
        return M if self.level is None else sum_shape(M, confidence(self.level, len(P)) * P)


NoiseKind: TypeAlias = Literal["nominal", "matched"]


@dataclass(frozen=True, eq=False)
class MatchedModel(Model):
    """A model whose covariances treat bounded noises as uniform on their ellipsoids."""

    model: Model
    varies = property(lambda self: self.model.varies)

    def at(self, k: int) -> LinearModel:
        """The model at k: Q_w + M_w / (nx + 2), R_v + M_v / (ny + 2)."""
        now: LinearModel = self.model.at(k)
        sets = NoiseSets(self.model)
        M_w, M_v = sets.process(k), sets.measurement(k)
        if not (M_w.any() or M_v.any()):
            return now
        nd = self.model.n_disturbances
        Q_w, R_v = now.Q_w + uniform_covariance(M_w, nd), now.R_v + uniform_covariance(M_v)
        return LinearModel(now.A, now.B, now.C, Q_w, R_v, S_wv=now.S_wv, f0=now.f0, d0=now.d0, D=now.D)


def uniform_covariance(M: Float[Array, "n n"], n_disturbances: int = 0) -> Float[Array, "n n"]:
    """Return the covariance of the uniform distribution on E(0, M), whose last coordinates may have no bounded part."""
    return M / (len(M) - n_disturbances + 2)


def with_noise_kind(
    model: Model, P0: Float[Array, "nx nx"], M0: Float[Array, "nx nx"] | None, noise: NoiseKind
) -> tuple[Model, Float[Array, "nx nx"]]:
    """Return a model and an initial covariance that treat bounded parts as uniform (`matched`) or omit them."""
    if noise == "nominal":
        return model, P0
    return MatchedModel(model), P0 if M0 is None else P0 + uniform_covariance(M0, model.n_disturbances)


def stochastic_sets(model: Model) -> NoiseSets:
    """Return the confidence ellipsoids of the covariances of a model, for a method that needs sets."""
    return NoiseSets(model, LEVEL, bounded=False)


@dataclass(frozen=True)
class Density:
    """White noise in continuous time, sampled with the equations of a continuous model or plant.

    Parameters
    ----------
    density : spectral density Q_c of the noise of x', or R_c of that of y; Q_w is the integral of e^(A s) Q_c e^(A' s)
        over a sample, R_v = R_c / Ts
    """

    density: Matrix


@dataclass(frozen=True)
class DesignNoise:
    """Noise of a design model, white and added to the sampled state and to the output.

    Parameters
    ----------
    process : covariance Q_w of the noise of x(k+1), or {density: ..}
    measurement : covariance R_v of the noise of y(k), or {density: ..}
    """

    process: Matrix | Density
    measurement: Matrix | Density

    def covariances(
        self, nx: int, ny: int, Ts: float | None = None, A: Float[Array, "nx nx"] | None = None
    ) -> tuple[Float[Array, "nx nx"], Float[Array, "ny ny"]]:
        """Return Q_w and R_v; `Ts` and the Jacobian `A` are for densities, where Q_w = Ts Q_c without `A`."""
        found = []
        for name, n in (("process", nx), ("measurement", ny)):
            given, key = getattr(self, name), f"noise.{name}"
            if not isinstance(given, Density):
                found.append(as_covariance(given, n, key))
                continue
            if Ts is None:
                raise DesignError("density needs a continuous model", f"{key}.density")
            S = as_covariance(given.density, n, f"{key}.density")
            found.append(S / Ts if name == "measurement" else over_sample(S, Ts, A))
        return found[0], found[1]


def over_sample(S: Float[Array, "n n"], Ts: float, A: Float[Array, "n n"] | None) -> Float[Array, "n n"]:
    """Return the covariance due to white noise of x' with density S over a sample; Ts S without a Jacobian A of x'."""
    return Ts * S if A is None else van_loan(A, S, Ts)


@dataclass(frozen=True)
class NoiseScale:
    """Factors on the standard deviations of the noises of a design model; the noise of the plant does not change.

    Parameters
    ----------
    process : factor on the standard deviation of the process noise
    measurement : factor on the standard deviation of the measurement noise
    """

    process: NonNegative = 1.0
    measurement: NonNegative = 1.0


SAME_SCALE = NoiseScale()
