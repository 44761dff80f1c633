"""Noise that is correlated over time: a random walk, and first-order coloured noise.

Model   `drift`  w(0) = start, w(k) = w(k-1) + d(k), d(k) ~ N(0, D).  E (w(j) - start)(w(k) - start)' = min(j, k) D.
        `coloured`  w(k) = mean + c(k), c(k+1) = a c(k) + sqrt(1 - a^2) d(k+1), c(0) = d(0), d(k) ~ N(0, cov), with a
                    correlation time a = exp(-Ts/time).  Stationary: E c(j) c(k)' = a^|j - k| cov.
Moments `drift`  mean `start`, no constant covariance; not white, so that `evaluate: moments` is refused.
        `coloured`  `mean` and `cov`; not white, so that `evaluate: moments` is refused.
Limit   `coloured`  a = 0 is `gaussian`.
Source  Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 8.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from math import exp, sqrt
from typing import Annotated

import numpy as np
from annotated_types import Gt, Lt
from jaxtyping import Float

from rmpc_bench.noise.bursts import BurstyNoise, RandomBursts, with_bursts
from rmpc_bench.noise.gaussian import FromNormal, spread_root
from rmpc_bench.numerics.linalg import as_vector
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import Array, DesignError, Matrix, NonNegative, Positive

EQUATION = {
    "drift": r"w_{k+1} = w_k + s z_k, \quad z_k \sim \mathcal{N}(0, \Sigma)",
    "coloured": r"""w_{k+1} = a w_k + \sqrt{1 - a^2} s z_k, \quad
z_k \sim \mathcal{N}(0, \Sigma), \quad a = e^{-T_s / \tau}""",
}


@dataclass(frozen=True, eq=False)
class Drift(FromNormal):
    """Random walk whose increments are root z; its mean is the value at k = 0."""

    is_white = False

    def deviation(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run without its start."""
        return self.enlarged(rng, np.ones(n_samples))

    def enlarged(self, rng: np.random.Generator, gain: Float[Array, " samples"]) -> Float[Array, "samples n"]:
        """Noise of one run without its start, with a factor on every increment: a burst leaves no jump at its end."""
        increments = gain[:, None] * self.normal(rng, len(gain))
        increments[:1] = 0.0
        return np.cumsum(increments, axis=0)


@dataclass(frozen=True, eq=False)
class Coloured(FromNormal):
    """Stationary first-order noise with one pole."""

    pole: float
    is_white = False
    cov = property(lambda self: self.root @ self.root.T)

    def deviation(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run without its mean."""
        n, a = len(self.mean), self.pole
        d = self.normal(rng, n_samples)
        d[1:] *= sqrt(1.0 - a * a)
        # Numbers of Python: 0.24 ms for 1000 samples of two numbers, where a loop over rows of NumPy takes 1.6 ms.
        columns = [list(accumulate(column, lambda last, new: a * last + new)) for column in d.T.tolist()]
        return np.ascontiguousarray(np.array(columns).reshape(n, n_samples).T)


def drift(
    n: int,
    Ts: Positive = 1.0,
    *,
    std: NonNegative | list[NonNegative] | None = None,
    cov: Matrix | Array | None = None,
    start: float | list[float] = 0.0,
    scale: NonNegative = 1.0,
    bursts: list[Burst] | RandomBursts | None = None,
) -> Drift | BurstyNoise:
    """Random walk: a sum of normal increments; give either std or cov.

    Parameters
    ----------
    n : dimension
    Ts : sampling time [s], for bursts
    std : standard deviation of the increment from one sample to the next
    cov : covariance of an increment
    start : value at k = 0
    scale : factor on the standard deviation
    bursts : time intervals of larger noise, as in `uniform`

    Raises
    ------
    DesignError
        If both or none of std and cov are given, a size does not fit, or a burst does not fit into its window.
    """
    return with_bursts(Drift(as_vector(start, n, "start"), scale * spread_root(n, std, cov)), bursts, Ts)


def coloured(
    n: int,
    Ts: Positive = 1.0,
    *,
    std: NonNegative | list[NonNegative] | None = None,
    cov: Matrix | Array | None = None,
    time: Positive | None = None,
    pole: Annotated[float, Gt(-1), Lt(1)] | None = None,
    mean: float | list[float] = 0.0,
    scale: NonNegative = 1.0,
    bursts: list[Burst] | RandomBursts | None = None,
) -> Coloured | BurstyNoise:
    """First-order coloured noise (Gauss-Markov), stationary from k = 0 on; give std or cov, and time or pole.

    Parameters
    ----------
    n : dimension
    Ts : sampling time [s]
    std : standard deviation of a sample
    cov : covariance of a sample
    time : correlation time [s], in which the correlation decays to 1/e
    pole : correlation of a sample with the next one
    mean : mean of the noise
    scale : factor on the standard deviation
    bursts : time intervals of larger noise, as in `uniform`

    Raises
    ------
    DesignError
        If both or none of std and cov, or of time and pole, are given, a size does not fit, or a burst does not fit
        into its window.
    """
    if (time is None) == (pole is None):
        raise DesignError("give either time or pole")
    a = exp(-Ts / time) if time is not None else pole or 0.0
    return with_bursts(Coloured(as_vector(mean, n, "mean"), scale * spread_root(n, std, cov), a), bursts, Ts)
