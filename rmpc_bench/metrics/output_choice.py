"""Components of the output that a metric reads, and the unit that they have in common."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, TypeAlias

from annotated_types import Ge
from jaxtyping import Float

from rmpc_bench.metrics.means import moving_mean
from rmpc_bench.types import Array, DesignError, Issue, MetricLayout, Record

Index: TypeAlias = Annotated[int, Ge(0)]


def control_error(
    record: Record, components: Sequence[int] | None = None, smooth: float = 0.0
) -> Float[Array, "runs samples n"]:
    """Return r - y at all samples, or its moving mean.

    Parameters
    ----------
    record : the trajectories
    components : outputs that count, from 0; None for all
    smooth : length of the moving mean [s]; 0 for none
    """
    error: Array = record.r - record.y
    if components is not None:
        error = error[:, :, list(components)]
    return moving_mean(error, max(1, round(smooth / record.Ts))) if smooth else error


def check_components(layout: MetricLayout, components: Sequence[int] | None) -> Iterator[Issue]:
    """Find outputs that are named twice or do not exist."""
    if components is None:
        return
    if not components or len(set(components)) < len(components):
        yield Issue("components", f"must name at least one output, and no output twice (got {components})")
    elif layout.plant is not None and max(components) >= layout.plant.ny:
        yield Issue(
            "components",
            f"there is no y.{max(components)}: the plant has {layout.plant.ny} outputs (they count from 0)",
        )


def unit_and_scale(layout: MetricLayout, components: Sequence[int] | None, unit: str | None) -> tuple[str, float]:
    """Return the unit of the value and the factor from the common unit of the outputs.

    Parameters
    ----------
    layout : of the experiment
    components : outputs that count, from 0; None for all
    unit : the common unit of the outputs, or ``m`` before it for a thousandth; None for the common unit

    Raises
    ------
    DesignError
        If the outputs have no unit in common, or the given one is neither of the two.
    """
    common = _common_unit(layout, components)
    if unit is None or unit == common:
        return common, 1.0
    if not common:
        raise DesignError("the components have no unit in common; name those of one unit in components", "unit")
    if unit != f"m{common}":
        raise DesignError(f"must be {common} or m{common}, a thousandth of it (got {unit!r})", "unit")
    return unit, 1e3


def _common_unit(layout: MetricLayout, components: Sequence[int] | None) -> str:
    """Return the unit that the outputs have in common; empty where they differ."""
    units = {layout.y_unit}
    if layout.plant is not None:
        numbers = range(layout.plant.ny) if components is None else components
        units = {layout.plant.units.get(f"y.{number}", layout.y_unit) for number in numbers}
    return units.pop() if len(units) == 1 else ""
