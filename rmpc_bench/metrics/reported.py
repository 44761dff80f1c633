"""Metrics of numbers that estimators and controllers report, such as tuned penalties or bounds of the noise."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from annotated_types import Ge
from jaxtyping import Float

from rmpc_bench.metrics.burst_samples import BurstMetric
from rmpc_bench.metrics.norms import per_run
from rmpc_bench.types import Array, DesignError, Direction, Issue, Method, MetricLayout, Record, WindowMetric, issues_of

Reduction: TypeAlias = Literal["median", "mean", "std", "min", "max", "sum", "last"]
Entry: TypeAlias = str | Annotated[int, Ge(0)]
"""Index of an entry of a reported signal: I for a vector, ``"I,J"`` for a matrix."""
FALLBACK = "fallback"
"""Name of the signal that an estimator reports: 1 if it used a simpler estimate instead of its own, else 0."""


@dataclass(frozen=True, kw_only=True)
class Reported(BurstMetric):
    """Signal that all methods report over k = 0..N-1, reduced to a number, such as the median of a tuned penalty.

    The value closest to 0 counts as best.  Samples before the first report are left out.  A method that does not report
    the signal is an error of the configuration.

    Parameters
    ----------
    of : name of the reported signal, such as Q_yw
    component : index (from 0), I or "I,J", or a list of them; all entries if not given
    reduce : statistic over samples and components; `last` needs one component
    normalised : whether to divide the entry I,J of a square matrix by the root of I,I times J,J

    Examples
    --------
    >>> record = Record.of_run(u=[0.0, 0.0, 0.0])._replace(info={"gain": np.array([[[1.0], [5.0], [2.0]]])})
    >>> Reported(of="gain").evaluate(record).item(), Reported(of="gain", reduce="sum").evaluate(record).item()
    (2.0, 8.0)
    """

    name: str = "reported"
    of: str
    component: Entry | list[Entry] | None = None
    reduce: Reduction = "median"
    normalised: bool = False

    better: ClassVar[Direction] = "zero"
    input_only: ClassVar[bool] = True

    @property
    def needs_info(self) -> tuple[str, ...]:
        """Name of the reported signal."""
        return (self.of,)

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, missing bursts, and a signal that is not reported or has another shape."""
        yield from super().check(layout)
        yield from issues_of(self._check_shape, layout)

    def _check_shape(self, layout: MetricLayout) -> None:
        shape = _shape(layout.methods, self.of)
        if shape is None:
            return
        places = _places(self.of, shape, self.component)
        if self.normalised and (len(shape) != 2 or shape[0] != shape[1]):
            raise DesignError(f"{self.of} has {_sizes(shape)}; only a square matrix is normalised", "normalised")
        if self.reduce == "last" and len(places) > 1:
            raise DesignError(f"last needs one component, but {len(places)} are selected; choose one", "component")

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Reduce the entries at the samples that count."""
        if self.of not in record.info:
            return np.full(len(record.y), np.nan)
        values = record.info[self.of][:, self.samples(record).slice]
        # Entries of unknown shape are those of a vector.
        shape = _shape(record.layout.methods, self.of)
        places = _places(self.of, values.shape[2:] if shape is None else shape, self.component)
        if self.normalised:
            values = normalised_entries(values)
        return per_run(values[:, :, list(places)], self.counted(record), self._reduced)

    def _reduced(self, values: Float[Array, "kept n"]) -> float:
        # NaN before it is reported for the first time.
        known = values[~np.isnan(values)]
        if not known.size:
            return math.nan
        return float(known[-1] if self.reduce == "last" else getattr(np, self.reduce)(known))


def normalised_entries(values: Float[Array, "runs window nn"]) -> Float[Array, "runs window nn"]:
    """M_ij / sqrt(M_ii M_jj) of square matrices, row by row; NaN where a diagonal entry is 0."""
    n = math.isqrt(values.shape[2])
    M = values.reshape(*values.shape[:2], n, n)
    diagonal = np.diagonal(M, axis1=2, axis2=3)
    with np.errstate(all="ignore"):
        scale = np.sqrt(diagonal[..., :, None] * diagonal[..., None, :])
        ratios: Array = np.where(scale > 0.0, M / scale, np.nan)
    return ratios.reshape(values.shape)


def _shape(methods: Sequence[Method], of: str) -> tuple[int, ...] | None:
    """Shape of a signal that all methods report; None if there are no methods."""
    known = {method.name: method.reports for method in methods}
    without = [f"{name!r} ({_listed(found)})" for name, found in known.items() if of not in found]
    if without:
        raise DesignError(
            f"{of!r} is not reported by {', '.join(without)}; leave the metric or the method out, or choose another",
            "of",
        )
    shapes = {found[of] for found in known.values()}
    if len(shapes) > 1:
        raise DesignError(f"{of!r} has {' or '.join(map(_sizes, sorted(shapes)))}, depending on the method", "of")
    return shapes.pop() if shapes else None


def _listed(found: Mapping[str, object]) -> str:
    return f"which reports {', '.join(sorted(found))}" if found else "which reports nothing"


def _sizes(shape: tuple[int, ...]) -> str:
    return f"{' x '.join(map(str, shape))} entries" if shape else "one entry"


def _places(of: str, shape: tuple[int, ...], given: Entry | list[Entry] | None) -> tuple[int, ...]:
    """Places of entries, row by row."""
    if given is None:
        return tuple(range(math.prod(shape)))
    entries = given if isinstance(given, list) else [given]
    if not entries:
        raise DesignError("must name at least one entry", "component")
    return tuple(_place(of, shape, str(entry)) for entry in entries)


def _place(of: str, shape: tuple[int, ...], entry: str) -> int:
    found = re.fullmatch(r"[0-9]+(?:\s*,\s*[0-9]+)*", entry)
    index = tuple(map(int, entry.split(","))) if found else ()
    if not shape or len(index) != len(shape) or any(i >= n for i, n in zip(index, shape, strict=True)):
        first, last = (",".join(map(str, corner)) for corner in ([0] * len(shape), [n - 1 for n in shape]))
        way_out = f'choose "{first}" to "{last}" (they count from 0)' if shape else "leave component out"
        raise DesignError(f"{of} has {_sizes(shape)} and no {entry!r}; {way_out}", "component")
    return int(np.ravel_multi_index(index, shape))


@dataclass(frozen=True, kw_only=True)
class Fallbacks(WindowMetric):
    """Number of samples k = 0..N-1 at which the estimator used a simpler estimate instead of its own; lower is better.

    It is 0 for an estimator that reports no fallback.

    Examples
    --------
    >>> record = Record.of_run(y=[0.0, 0.0, 0.0])._replace(info={"fallback": np.array([[[1.0], [0.0], [1.0]]])})
    >>> Fallbacks().evaluate(record).item(), Fallbacks(to="N").evaluate(record).item()
    (1.0, 2.0)
    """

    name: str = "fallbacks"

    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)
    needs_info: ClassVar[tuple[str, ...]] = (FALLBACK,)

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Count the samples."""
        if FALLBACK not in record.info:
            return np.zeros(len(record.y))
        fallback = record.info[FALLBACK][:, self.samples(record).slice, 0] == 1.0
        count: Array = fallback.sum(axis=1).astype(float)
        return count
