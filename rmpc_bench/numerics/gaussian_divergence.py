"""The Kullback-Leibler divergence of one normal density from another, in its two parts.

Between the true density N(m~, K~) and the nominal density N(m, K), both of dimension n and with dm = m~ - m:

    D = 1/2 [tr(K^-1 K~) - n - ln det(K^-1 K~)]  +  1/2 dm' K^-1 dm
              covariance part                          mean part

Source  zenere2018, (10), for normal densities.
Limit   K~ = K and dm = 0 give 0; neither part is negative.
Fails   numpy.linalg.LinAlgError where K is singular.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.types import Array


def covariance_part(K_true: Float[Array, "*batch n n"], K: Float[Array, "*#batch n n"]) -> Float[Array, "*batch"]:
    """Return the part that does not depend on the means; infinite where K~ is singular.

    It is the sum of (lam - 1 - ln lam) / 2 over the eigenvalues lam of K^-1 K~: no term is negative, so none cancels.

    Parameters
    ----------
    K_true : (..., n, n) covariance K~ of the true density
    K : (..., n, n) covariance of the nominal density, positive definite
    """
    excess = np.maximum(np.linalg.eigvalsh(_whitened(K_true, K)), 0.0) - 1.0
    with np.errstate(divide="ignore"):
        terms: Array = excess - np.log1p(excess)  # keeps its digits where the two densities are close
    return np.asarray(0.5 * terms.sum(axis=-1))


def mean_part(moment: Float[Array, "*batch n n"], K: Float[Array, "*#batch n n"]) -> Float[Array, "*batch"]:
    """Return the expectation of dm' K^-1 dm / 2.

    Parameters
    ----------
    moment : (..., n, n) expectation of dm dm'
    K : (..., n, n) covariance of the nominal density, positive definite
    """
    return np.asarray(0.5 * np.trace(_whitened(moment, K), axis1=-2, axis2=-1))


def _whitened(M: Float[Array, "*batch n n"], K: Float[Array, "*#batch n n"]) -> Float[Array, "*batch n n"]:
    """W M W' with W K W' = I."""
    root = np.linalg.cholesky(K)
    white: Array = np.linalg.solve(root, np.linalg.solve(root, M).mT)
    return symmetrise(white)
