"""Sets that a method reports for the state of a run: the set M, or a confidence ellipsoid of the covariance P."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from rmpc_bench.figures.recorded_runs import find_run
from rmpc_bench.figures.window import TimeWindow
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

EDGE = 1e-9
"""Relative distance beyond the edge up to which a state counts as inside: rounding."""

_Value = TypeVar("_Value")


class Tube(NamedTuple):
    """States, estimates and reported sets of one run, at the samples that are shown."""

    x: Array
    """(samples, components) true states."""
    x_hat: Array
    """(samples, components)."""
    S: Array
    """(samples, components, components): x is reported to lie in E(x_hat, S)."""
    gaussian: bool
    """Whether S is the shape of a confidence ellipsoid."""
    status: str


def reported_set(values: Mapping[str, _Value]) -> _Value | None:
    """Choose the set M, else the covariance P, from values by quantity; None if there is neither."""
    return values.get("M", values.get("P"))


def tube_of(point: Trials, name: str, run: int, components: Sequence[int], window: TimeWindow, level: float) -> Tube:
    """Read the run of a method and the sets that it reports; a method without M has the ellipsoid of P at `level`."""
    row, status = find_run(point, name, run)
    x, x_hat = (point.traces[name].signals[signal][row] for signal in ("x", "x_hat"))
    S, gaussian = _shapes(point, name, level)
    S = S[window.slice] if len(S) > 1 else np.repeat(S, window.last + 1 - window.first, axis=0)
    chosen = list(components)
    # The projection of an ellipsoid has this part of its shape matrix.
    part = S[:, chosen][:, :, chosen]
    return Tube(x[window.slice][:, chosen], x_hat[window.slice][:, chosen], part, gaussian, status)


def _shapes(point: Trials, name: str, level: float) -> tuple[Array, bool]:
    """Return the shape matrices of the reported sets, axis 0 = k, and whether they are made from P."""
    known = point.series.loc[point.series["method"] == name, "quantity"].unique()
    quantity = reported_set({quantity: str(quantity) for quantity in known})
    assert quantity is not None, "the check of the figure requires one"
    values = point.matrix_series(quantity, name)
    return (_quantile(level, values.shape[-1]) * values, True) if quantity == "P" else (values, False)


def _quantile(level: float, n: int) -> float:
    """Return the quantile of chi-square with n degrees of freedom."""
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(n / 2.0, level))
