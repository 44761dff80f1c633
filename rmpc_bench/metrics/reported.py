"""Metrics of what estimators and controllers report of themselves, such as tuned penalties or bounds of the noise."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import numpy as np
from annotated_types import Ge
from jaxtyping import Float

from rmpc_bench.metrics.burst_samples import During, When, during_of, per_run
from rmpc_bench.metrics.tracking import Bound, SampleMetric, Units, Window, window_of
from rmpc_bench.types import Array, DesignError, Method, MetricInfo, NonNegative, Record

Reduction = Literal["median", "mean", "std", "min", "max", "sum", "last"]
Component: TypeAlias = str | Annotated[int, Ge(0)]
FALLBACK = "fallback"
"""What an estimator reports: 1 where it fell back on something simpler, else 0."""


@dataclass(frozen=True)
class Reported:
    """Parameters of `reported`."""

    of: str
    places: tuple[int, ...] | None
    """Entries that count, row by row; None for all."""
    during: During
    reduction: Reduction
    normalised: bool

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Reduce the entries at the samples that count."""
        if self.of not in record.info:
            return np.full(len(record.y), np.nan)
        values = record.info[self.of][:, window.slice]
        if self.normalised:
            values = _normalised(values)
        if self.places is not None:
            values = values[:, :, list(self.places)]
        return per_run(values, self.during.among(record, window), self._reduced)

    def _reduced(self, values: Float[Array, "kept n"]) -> float:
        known = values[~np.isnan(values)]  # there is none before it is reported first
        if not known.size:
            return math.nan
        return float(known[-1] if self.reduction == "last" else getattr(np, self.reduction)(known))


def _normalised(values: Float[Array, "runs window nn"]) -> Float[Array, "runs window nn"]:
    """M_ij / sqrt(M_ii M_jj), row by row; NaN where a diagonal entry is 0."""
    n = math.isqrt(values.shape[2])
    M = values.reshape(*values.shape[:2], n, n)
    diagonal = np.diagonal(M, axis1=2, axis2=3)
    with np.errstate(all="ignore"):
        units = np.sqrt(diagonal[..., :, None] * diagonal[..., None, :])
        ratios: Array = np.where(units > 0.0, M / units, np.nan)
    return ratios.reshape(values.shape)


def reported(
    units: Units,
    *,
    name: str = "reported",
    of: str,
    component: Component | list[Component] | None = None,
    during: When = "all",
    memory: NonNegative = 0.0,
    reduce: Reduction = "median",
    normalised: bool = False,
    from_: Bound = None,
    to: Bound = None,
) -> SampleMetric:
    """Reduce what all methods report over k = 0..N-1 to a number, such as the median of a tuned penalty in bursts.

    What is not reported yet, as before a tuning starts, is left out.  A method that does not report it is refused.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    of : what is reported, such as Q_yw
    component : the entry that counts, from 0: I of a vector, "I,J" of a matrix, or a list of entries that count
        together; all unless given
    during : all samples, those in bursts, or the quiet ones, which are not
    memory : how long a burst counts after its end [s]
    reduce : over samples and components; last needs one component
    normalised : divide the entry I,J of a square matrix by the root of I,I times J,J
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included
    """
    shape = _shape(units.methods, of)
    places = None
    if shape is not None:
        places = _places(of, shape, component)
        if normalised and (len(shape) != 2 or shape[0] != shape[1]):
            raise DesignError(f"{of} has {_sizes(shape)}; only a square matrix is normalised", "normalised")
        if reduce == "last" and len(places) > 1:
            raise DesignError(f"last is one of {len(places)} entries at the last sample; choose it", "component")
    during_samples = during_of(units, during, memory)
    last = units.n_steps - 1  # no input is chosen at k = N
    window = window_of(units, from_, to, last, last)
    return SampleMetric(
        MetricInfo(name, "", "zero"),
        window,
        Reported(of, places, during_samples, reduce, normalised),
        needs_info=(of,),
    )


def _shape(methods: Sequence[Method], of: str) -> tuple[int, ...] | None:
    """Shape of what all methods report; None where there are no methods."""
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


def _places(of: str, shape: tuple[int, ...], given: Component | list[Component] | None) -> tuple[int, ...]:
    """Places of entries, row by row."""
    if given is None:
        return tuple(range(math.prod(shape)))
    components = given if isinstance(given, list) else [given]
    if not components:
        raise DesignError("must name at least one entry", "component")
    return tuple(_place(of, shape, str(component)) for component in components)


def _place(of: str, shape: tuple[int, ...], component: str) -> int:
    found = re.fullmatch(r"[0-9]+(?:\s*,\s*[0-9]+)*", component)
    index = tuple(map(int, component.split(","))) if found else ()
    if not shape or len(index) != len(shape) or any(i >= n for i, n in zip(index, shape, strict=True)):
        first, last = (",".join(map(str, corner)) for corner in ([0] * len(shape), [n - 1 for n in shape]))
        way_out = f'choose "{first}" to "{last}" (they count from 0)' if shape else "leave component out"
        raise DesignError(f"{of} has {_sizes(shape)} and no {component!r}; {way_out}", "component")
    return int(np.ravel_multi_index(index, shape))


def fallbacks(units: Units, *, name: str = "fallbacks", from_: Bound = None, to: Bound = None) -> SampleMetric:
    """Number of samples k = 0..N-1 at which the estimator fell back on something simpler; 0 where it never does.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    window = window_of(units, from_, to, units.n_steps - 1, units.n_steps)
    return SampleMetric(MetricInfo(name, "", "lower"), window, _fallbacks, needs_info=(FALLBACK,))


def _fallbacks(record: Record, window: Window) -> Float[Array, " runs"]:
    if FALLBACK not in record.info:
        return np.zeros(len(record.y))
    fell = record.info[FALLBACK][:, window.slice, 0] == 1.0
    count: Array = fell.sum(axis=1).astype(float)
    return count
