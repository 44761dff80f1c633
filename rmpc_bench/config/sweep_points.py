"""The points of a sweep as claims and figures name them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rmpc_bench.types.sweep_points import no_such_point


class Place(NamedTuple):
    """A point of a sweep."""

    coordinates: Mapping[str, str]
    """Path -> text of the value."""
    keys: Mapping[str, str] = {}
    """Method -> what identifies its trials; empty where the point could not be built."""


def nowhere(places: Sequence[Place], wanted: Mapping[str, str]) -> str:
    """Say why a sweep has no point with the wanted values; empty when it has one, or its points are not known."""
    return no_such_point([place.coordinates for place in places], wanted)
