"""What is drawn of a part, and what the results of an experiment will have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from jaxtyping import Float

from rmpc_bench.types.basics import Array


class Line(NamedTuple):
    """A curve of a part's picture."""

    label: str
    x: Float[Array, " points"]
    y: Float[Array, " points"]
    """NaN makes a gap."""
    dots: bool = False
    """Whether the points are marked instead of joined."""
    notes: tuple[str, ...] = ()
    """What is written beside the points, one text each; nothing unless given."""


class Panel(NamedTuple):
    """A picture of a part itself, such as its friction; a design may have ``portrait() -> tuple[Panel, ...]``."""

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]
    equal: bool = False
    """Whether a unit is as long on both axes, as in a plan."""


class ResultLayout(NamedTuple):
    """What the results of an experiment will have, as far as that is known before it runs."""

    signals: Mapping[str, int | None]
    """Recorded signal -> number of its components, None where that is not known."""
    end: float
    """Last time [s]; 0 in a smoke run, which is shorter than its figures ask for."""
    series: Mapping[str, tuple[int, ...]]
    """Series of the designs -> shape of an entry."""
    n_points: int
    """Points of the sweep."""
    arrays: Mapping[str, Mapping[str, tuple[int, ...]]] = {}
    """Method -> series at the first point -> shape, axis 0 = k, of length 1 where it is the same at all k."""
    n_recorded: int = 0
    """Runs whose signals are kept, the first ones."""
    reports: Mapping[str, Mapping[str, tuple[int, ...]]] = {}
    """Method -> recorded signal that it reports of itself -> shape of an entry."""
