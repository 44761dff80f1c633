"""Tables of trials with shares of covered errors, and shares of errors that are correlated in time."""

from dataclasses import replace

import numpy as np
from comparison_tables import table
from scipy import signal, stats

from rmpc_bench.types import MetricInfo
from rmpc_bench.types.metric import CalibrationKeys


def coverage_trials(shares, keys=None, **others):
    """Return a table of methods -> metric -> (n,) shares; NaN has no covariance, an array for None a failed run."""
    keys = keys or CalibrationKeys()
    names = [*dict.fromkeys(name for of in shares.values() for name in of)]
    first = table({method: of[names[0]] for method, of in shares.items()}, metric=names[0], direction="higher")
    columns = dict(first.columns)
    for name in names:
        columns[name] = np.concatenate([np.asarray(of[name], dtype=float) for of in shares.values()])
    columns["status"] = np.full(len(columns["run"]), "ok", dtype=object)
    infos = tuple(MetricInfo(name, "", "higher") for name in names)
    return replace(first, columns=columns, metrics=infos, calibration=keys, **others)


def errors(rng, runs, samples=100, rho=0.9, n=2, dof=None):
    """Return (runs, samples) squares e' e of stationary errors of unit covariance with correlation rho^k over time.

    With `dof` the innovations are those of Student's t, scaled to unit variance.
    """
    w = rng.standard_normal((runs, samples, n))
    if dof is not None:
        w /= np.sqrt(rng.chisquare(dof, (runs, samples))[..., None] / (dof - 2))
    # The first sample has the stationary covariance.
    w[:, 1:] *= np.sqrt(1 - rho**2)
    e = signal.lfilter([1.0], [1, -rho], w, axis=1)
    return (e**2).sum(axis=2)


def shares(squares, s, level=0.9, n=2):
    """Return the share of covered errors per run for a reported covariance s^2 I."""
    return (squares <= s**2 * stats.chi2.ppf(level, n)).mean(axis=1)


def of_squares(squares, s, levels=(0.5, 0.9, 0.95)):
    """Return metric -> shares for a covariance s^2 I of two states; the single states repeat the numbers."""
    found = {level: shares(squares, s, level) for level in levels}
    return {CalibrationKeys.name(p, of): each for of in ("joint", "x.0", "x.1") for p, each in found.items()}
