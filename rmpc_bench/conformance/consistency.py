"""Whether the errors of an estimator agree with its reported covariance: nees and nis inside chi-square bands."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import congruence, mv
from rmpc_bench.types import Array

SPACING = 10
"""Samples between those that count; with fast modes their errors are nearly independent."""
QUANTILE = 4.0
"""Standard normal quantile of both ends of a band: outside once in 16,000 times by chance."""


def band(degrees: int) -> tuple[float, float]:
    """Return the quantiles of chi-square over its degrees of freedom, after Wilson and Hilferty.

    Parameters
    ----------
    degrees : of freedom; the ends are off by 1e-2 at 30 and by 1e-4 at 1000

    Examples
    --------
    >>> low, high = band(1000)
    >>> round(low, 3), round(high, 3)
    (0.831, 1.189)
    """
    spread = 2.0 / (9.0 * degrees)
    low, high = ((1.0 - spread + sign * QUANTILE * math.sqrt(spread)) ** 3 for sign in (-1.0, 1.0))
    return low, high


def consistency_text(
    model: LinearModel,
    recorded: tuple[Array, Array, Array],
    x_hat: Float[Array, "runs samples nx"],
    P: Float[Array, "samples nx nx"] | Float[Array, "runs samples nx nx"],
    *,
    predictor: bool,
) -> str:
    """Compare normalised squares of errors and innovations with chi-square.

    Parameters
    ----------
    model : the true system
    recorded : y, u and x of the runs
    x_hat, P : estimates and their reported covariances
    predictor : whether x_hat(k) does not use y(k)

    Returns
    -------
    nees and nis, where both are inside their bands.

    Raises
    ------
    AssertionError
        If one is outside.
    """
    y, u, x = recorded
    n_runs, n_samples = x.shape[:2]
    P = np.broadcast_to(P, (n_runs, *P.shape[-3:]))
    ks = range(2 * SPACING, n_samples - 1, SPACING)
    nees = [_squares(x_hat[:, k] - x[:, k], P[:, k]) for k in ks]
    nis = []
    for k in ks:
        if predictor:
            x_pred, P_pred = x_hat[:, k + 1], P[:, k + 1]
        else:
            x_pred = mv(model.A, x_hat[:, k]) + mv(model.B, u[:, k]) + model.f0
            P_pred = congruence(model.A, P[:, k]) + model.Q_w
        e = y[:, k + 1] - mv(model.C, x_pred) - model.d0
        nis.append(_squares(e, congruence(model.C, P_pred) + model.R_v))
    texts, wrong = [], []
    for name, values, n in (("nees", nees, x.shape[2]), ("nis", nis, y.shape[2])):
        mean, (low, high) = float(np.mean(values)) / n, band(n_runs * len(nees) * n)
        texts.append(f"{name} {mean:.3g} (band {low:.3g}..{high:.3g})")
        if not low <= mean <= high:
            wrong.append(f"{texts[-1]}: P is too {'small' if not mean <= high else 'large'}")
    if wrong:
        raise AssertionError("; ".join(wrong))
    return ", ".join(texts)


def _squares(e: Float[Array, "runs n"], P: Float[Array, "runs n n"]) -> Float[Array, " runs"]:
    """Return e' P^-1 e of every run; a singular P has its pseudo-inverse."""
    squares: Array = np.einsum("ri,rij,rj->r", e, np.linalg.pinv(P, hermitian=True), e)
    return squares
