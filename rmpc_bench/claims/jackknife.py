"""Intervals of what is computed from moments over the runs: every group of runs is left out once.

A value theta of U groups has the pseudo-values ``U theta - (U - 1) theta without a group``; their mean and its standard
error give Student intervals.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rmpc_bench.analysis.run_groups import MAX_GROUPS
from rmpc_bench.claims import tree
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.types import Array


class PseudoValues(NamedTuple):
    """Both sides of a comparison and its tolerance, axis 0 = group."""

    left: Array
    right: Array
    tolerance: Array


def pseudo_values(link: tree.Link, evaluator: Evaluator) -> PseudoValues | None:
    """Compute both sides without every group of runs; None for fewer than two groups that can be left out."""
    groups = evaluator.groups
    if not evaluator.sampled:
        groups = np.array_split(evaluator.runs, min(len(evaluator.runs), MAX_GROUPS) or 1)
    if groups is None or len(groups) < 2:
        return None
    whole = _sides(link, evaluator.without(None, ()))
    parts = [_sides(link, evaluator.without(number, runs)) for number, runs in enumerate(groups)]
    n = len(groups)
    stacked = [np.stack(column) for column in zip(*parts, strict=True)]
    with np.errstate(invalid="ignore"):  # A mean may be infinite.
        return PseudoValues(*(n * a - (n - 1) * without for a, without in zip(whole, stacked, strict=True)))


def _sides(link: tree.Link, evaluator: Evaluator) -> tuple[Array, Array, Array]:
    left, right, tolerance = evaluator.sides(link)
    return left.array, right, tolerance
