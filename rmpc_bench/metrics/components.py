"""Components of a signal that a metric reads: their choice, their divisors, and the unit that they have in common."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, TypeAlias

import numpy as np
from annotated_types import Ge
from jaxtyping import Float

from rmpc_bench.metrics.norms import moving_mean
from rmpc_bench.types import Array, DesignError, Issue, MetricLayout, Positive, Record, WindowMetric, issues_of
from rmpc_bench.types.angles import period_of, places, wrapped
from rmpc_bench.types.errors import unknown
from rmpc_bench.types.texts import squared

Chosen: TypeAlias = str | Annotated[int, Ge(0)]
NOUNS = {"y": "output", "x": "state", "u": "input"}


@dataclass(frozen=True, kw_only=True)
class ComponentMetric(WindowMetric):
    """A metric of the components of one signal.

    Parameters
    ----------
    only : names or indices (from 0) of the components that count (default: all), added to the name of the metric unless
        `name` is given
    """

    only: list[Chosen] | None = None

    letter: ClassVar[str] = "y"
    """The signal: y, x or u."""

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, and components that do not exist or are named twice."""
        yield from super().check(layout)
        if layout.plant is not None:
            yield from issues_of(self.indices, layout)

    def indices(self, layout: MetricLayout) -> list[int] | None:
        """Return the indices of the components that count; None for all."""
        if self.only is None:
            return None
        noun, names = NOUNS[self.letter], _names(layout, self.letter)
        for each in self.only:
            if isinstance(each, str) and each not in names:
                raise DesignError(unknown(each, names, noun), "only")
        found = [names[each] if isinstance(each, str) else each for each in self.only]
        if not found or len(set(found)) < len(found):
            article = "an" if noun[0] in "aeiou" else "a"
            raise DesignError(f"must name {article} {noun}, and each one once (got {self.only})", "only")
        n = max(found) + 1 if layout.plant is None else getattr(layout.plant, f"n{self.letter}")
        if max(found) >= n:
            message = f"there is no {self.letter}.{max(found)}: the plant has {n} {noun}s (they count from 0)"
            raise DesignError(message, "only")
        return found

    def chosen(self, values: Float[Array, "*samples n_all"], layout: MetricLayout) -> Float[Array, "*samples n"]:
        """Return the components that count."""
        indices = self.indices(layout)
        return values if indices is None else values[..., indices]

    def units(self, layout: MetricLayout) -> list[str]:
        """Return the units of the components that count, empty texts for those without one."""
        return units_of(layout, self.letter, None if layout.plant is None else self.indices(layout))


@dataclass(frozen=True, kw_only=True)
class SumMetric(ComponentMetric):
    """A metric that adds the sizes of components, or their squares.

    Parameters
    ----------
    scale : divisors that make the components dimensionless, by name or one per component that counts
    """

    scale: dict[str, Positive] | list[Positive] | None = None

    adds: ClassVar[str] = "sizes"
    """What is added: sizes or squares; empty where only the largest one counts."""
    is_root: ClassVar[bool] = False
    """Whether the value is the root of a sum of squares."""

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Add to the common checks: a divisor for every component that counts, and for no other."""
        issues = [*super().check(layout)]
        yield from issues or (issues_of(self.divisors, layout) if layout.plant is not None else ())

    def divisors(self, layout: MetricLayout) -> Float[Array, " n"] | None:
        """Return the divisors of the components that count; None where there are none."""
        names, indices = _names(layout, self.letter), self.indices(layout)
        if self.scale is None:
            return None
        wanted = [*range(getattr(layout.plant, f"n{self.letter}", 1))] if indices is None else indices
        if not isinstance(self.scale, dict):
            if len(self.scale) != len(wanted):
                raise DesignError(f"has {len(self.scale)} entries, and {len(wanted)} components count", "scale")
            return np.array(self.scale)
        for name in self.scale:
            if names.get(name) not in wanted:
                raise DesignError(unknown(name, _labels(layout, self.letter, wanted), NOUNS[self.letter]), "scale")
        found = {names[name]: value for name, value in self.scale.items()}
        if len(found) < len(self.scale):
            raise DesignError(f"must name each {NOUNS[self.letter]} once (got {', '.join(self.scale)})", "scale")
        missing = _labels(layout, self.letter, [i for i in wanted if i not in found])
        if missing:
            raise DesignError(f"has no number for {' and '.join(missing)}", "scale")
        return np.array([found[i] for i in wanted])

    def chosen(self, values: Float[Array, "*samples n_all"], layout: MetricLayout) -> Float[Array, "*samples n"]:
        """Return the components that count, divided by their scales."""
        divisors, values = self.divisors(layout), super().chosen(values, layout)
        return values if divisors is None else values / divisors

    def unit(self, layout: MetricLayout) -> str:
        """Return the unit that the components have in common; a scaled one has none."""
        unit = "" if self.scale is not None else in_common(self.units(layout))
        return squared(unit) if self.adds == "squares" and not self.is_root else unit

    def remark(self, record: Record | None, layout: MetricLayout) -> str:
        """Say which units are added, and which component makes most of the value in a run."""
        units = dict.fromkeys(unit or "1" for unit in self.units(layout))
        if len(units) < 2 or self.scale is not None:
            return ""
        *first, last = units
        what = f"adds {self.adds} of" if self.adds else "is the largest of sizes in"
        text = f"{self.name} {what} {', '.join(first)} and {last}"
        numbers = self.indices(layout) or range(len(self.units(layout)))
        if record is not None and self.adds:
            parts = np.array([abs(replace(self, only=[i]).evaluate(record)[0]) for i in numbers])
            parts = parts**2 if self.is_root else parts
            if np.isfinite(parts).all() and parts.any():
                name, share = _labels(layout, self.letter, numbers)[parts.argmax()], 100 * parts.max() / parts.sum()
                text += f"; {name} makes {share:.3g} % of it in the first run"
        return f"{text}: use `only` or `scale`"


def units_of(layout: MetricLayout, letter: str, indices: Iterable[int] | None) -> list[str]:
    """Return the units of components of y, x or u, of all if None; empty texts for those without one."""
    common = {"y": layout.y_unit, "u": layout.u_unit}.get(letter, "")
    if layout.plant is None:
        return [common]
    numbers = range(getattr(layout.plant, f"n{letter}")) if indices is None else indices
    return [layout.plant.units.get(f"{letter}.{i}", common) for i in numbers]


def in_common(units: Iterable[str]) -> str:
    """Return the unit that components have in common; empty where they differ."""
    found = {*units}
    return found.pop() if len(found) == 1 else ""


def _names(layout: MetricLayout, letter: str) -> dict[str, int]:
    """Return name of a component of a signal -> its index; the place, such as y.0, is a name, too."""
    if layout.plant is None:
        return {}
    n = getattr(layout.plant, f"n{letter}")
    return {name: i for i, name in enumerate(_labels(layout, letter, range(n)))} | {
        f"{letter}.{i}": i for i in range(n)
    }


def _labels(layout: MetricLayout, letter: str, indices: Sequence[int]) -> list[str]:
    """Return the names of components; their places where they have none."""
    names = {} if layout.plant is None else layout.plant.names
    return [names.get(f"{letter}.{i}", f"{letter}.{i}") for i in indices]


def output_error(record: Record) -> Float[Array, "runs samples ny"]:
    """Return y - r at all samples; that of an angle is wrapped."""
    error: Array = record.y - record.r
    return wrapped(error, period_of(record.layout.angles, places("y", error.shape[2])))


def smoothed(error: Float[Array, "runs samples n"], smooth: float, Ts: float) -> Float[Array, "runs samples n"]:
    """Return the centred moving mean over a time; the error itself for 0."""
    return moving_mean(error, max(1, round(smooth / Ts))) if smooth else error
