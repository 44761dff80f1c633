"""The points of a sweep as claims and figures name them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rmpc_bench.analysis.sweep_points import lies_at
from rmpc_bench.registry import unknown


class Place(NamedTuple):
    """A point of a sweep."""

    coordinates: Mapping[str, str]
    """Path -> text of the value."""
    keys: Mapping[str, str] = {}
    """Method -> what identifies its trials; empty where the point could not be built."""


def nowhere(places: Sequence[Place], wanted: Mapping[str, str]) -> str:
    """Say why a sweep has no point with the wanted values; empty when it has one, or its points are not known."""
    if not places or any(lies_at(place.coordinates, wanted) for place in places):
        return ""
    known = list(places[0].coordinates)
    if not known:
        return "nothing is swept in this configuration"
    for name, value in wanted.items():
        if name not in known:
            return unknown(name, known, "path of the sweep")
        values = list(dict.fromkeys(place.coordinates[name] for place in places))
        if not any(lies_at(place.coordinates, {name: value}) for place in places):
            return f"{name} has no value {value} in the sweep (it has {', '.join(values[:10])})"
    return "the sweep has no such point"
