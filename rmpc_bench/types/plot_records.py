"""Plot records: data that a component provides for plots."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Float

from rmpc_bench.types.basics import Array


class Line(NamedTuple):
    """A curve of a panel."""

    label: str
    x: Float[Array, " points"]
    y: Float[Array, " points"]
    """NaN makes a gap."""
    dots: bool = False
    """Whether the points are marked instead of joined."""
    notes: tuple[str, ...] = ()
    """What is written beside the points, one text each; nothing unless given."""


class Panel(NamedTuple):
    """A plot of a plant, such as its friction law (`Plant.plots`)."""

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]
    equal: bool = False
    """Whether a unit is as long on both axes, as in a plan."""
