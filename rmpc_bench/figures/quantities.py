"""Quantities over time that a figure of signals can show, found by the names that a configuration writes.

A name is that of a recorded signal, of a series of the designs or of the ensemble, or one of `DERIVED`.  A component
follows a dot, as in ``x_hat.2`` and ``P.1,1``; without one all components are meant.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.analysis.estimation_errors import INNOVATION, INNOVATION_COVARIANCE, MEAN, SCATTER
from rmpc_bench.analysis.traces import COVARIANCE
from rmpc_bench.figures.labels import component_label, symbol, unit_of, with_unit
from rmpc_bench.figures.recorded_runs import ERROR, OUTPUT, reported_set
from rmpc_bench.types.errors import Issue
from rmpc_bench.types.result_layout import NO_MOMENTS, NO_RECORDED_RUN, ResultLayout, Shape
from rmpc_bench.types.texts import squared

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

MEAN_STATE, MEAN_ESTIMATE = "mean(x)", "mean(x_hat)"
DERIVED = {
    "error": "needs recorded x and x_hat, record: {runs: 20, signals: [x, x_hat]}, or moments, "
    "evaluate: [runs, ensemble]",
    "variance": NO_MOMENTS,
    "mean": NO_MOMENTS,
    "tube": "needs recorded x and x_hat of a method that reports a set M or a covariance P: "
    "record: {runs: 1, signals: [x, x_hat]}",
    "nees": "needs the errors x_hat - x and a reported covariance P: record: {runs: 20, signals: [x, x_hat, P]}",
    "nis": "needs recorded e and S of some method that reports both: record: {runs: 20, signals: [e, S]}",
}  # quantities that are computed from others -> what is lacking where no method has them


class Quantity(NamedTuple):
    """What a row of panels shows."""

    kind: str  # ``recorded``, ``series`` or one of `DERIVED`
    name: str
    component: str = ""  # index as it is written; empty where there is one component only
    number: int = 0  # the same, counted row by row

    def label(self, point: Trials) -> str:
        """Name the axis."""
        if self.kind == "recorded" and self.name == ERROR:
            return with_unit(symbol(ERROR, self.component), unit_of(point, f"{OUTPUT}.{self.number}"))
        if self.kind == "recorded":
            return component_label(point, self.name, self.number, self.component)
        if self.kind == "series":
            return symbol(self.name, self.component)
        if self.kind in ("nees", "nis"):
            return f"average {self.kind.upper()} / ${'n_x' if self.kind == 'nees' else 'n_y'}$"
        unit = unit_of(point, f"x.{self.number}")
        if self.kind == "error":
            estimate, state = (symbol(name, self.component) for name in ("x_hat", "x"))
            return with_unit(f"{estimate} \N{MINUS SIGN} {state}", unit)
        if self.kind == "variance":
            return with_unit(f"var {symbol('e', self.component)}", squared(unit))
        words = component_label(point, "x", self.number, self.component)
        return f"mean {words}" if self.kind == "mean" else words


class _Text(NamedTuple):
    """Parts of the text that names a quantity."""

    kind: str
    name: str
    component: str


def _read(layout: ResultLayout, text: str) -> _Text:
    """Split a text into its parts; the own name of a series may have a dot."""
    name, _, component = text.partition(".")
    if (name in layout.signal_names or (name == ERROR and OUTPUT in layout.signal_names)) and "," not in component:
        return _Text("recorded", name, component)
    for series in (text, text.rpartition(".")[0]):
        if series and series in layout.series:
            return _Text("series", series, text.removeprefix(series).removeprefix("."))
    return _Text(name if name in DERIVED else "recorded", name, component)


def methods_with(layout: ResultLayout, text: str) -> list[str]:
    """Methods that have a quantity."""
    kind, name, _ = _read(layout, text)
    if kind == "series":
        return layout.methods_having(name)
    return [method for method in layout.methods if _has(layout, method, kind, name)]


def issue_of(layout: ResultLayout, text: str) -> Issue | None:
    """Say what is wrong with the name of a quantity; None where it can be shown."""
    kind, name, component = _read(layout, text)
    if not methods_with(layout, text):
        if kind in DERIVED:
            return Issue("signals", f"{name!r} {DERIVED[kind]}")
        if not layout.recorded and name in (OUTPUT, "u", "x", "x_hat"):
            return Issue("", NO_RECORDED_RUN)
        known = [f"recorded: {', '.join(layout.signal_names)}"] if layout.signal_names else []
        known += [f"series: {', '.join(layout.series)}"] if layout.series else []
        return Issue("signals", f"{name!r} is not recorded ({'; '.join(known) or NO_RECORDED_RUN})")
    shape = shape_of(layout, text)
    if not component or shape is None:
        return None
    if not shape and kind in ("series", "nees", "nis"):
        return Issue("signals", f"{text!r} is not a component: it is a number and has none")
    if _index(component, shape, kind) is not None:
        return None
    last = ",".join(str(n - 1) for n in shape) if kind == "series" else str(math.prod(shape) - 1)
    first, stem = ",".join("0" for _ in last.split(",")), text.removesuffix(component)
    return Issue("signals", f"{text!r} is not a component (they count from {stem}{first} to {stem}{last})")


def quantities(layout: ResultLayout, texts: Sequence[str]) -> Iterator[Quantity]:
    """Find the rows that names stand for, which have no issue; a name without component stands for all of them."""
    for text in texts:
        kind, name, component = _read(layout, text)
        shape = shape_of(layout, text) or ()
        many = math.prod(shape) > 1 and kind not in ("nees", "nis")
        for index in [_index(component, shape, kind) or 0] if component else range(math.prod(shape)):
            yield Quantity(kind, name, ",".join(map(str, np.unravel_index(index, shape))) if many else "", index)


def n_rows(layout: ResultLayout, texts: Sequence[str]) -> int:
    """Count the rows of panels, as far as shapes are known."""
    return sum(1 if _read(layout, text).component else math.prod(shape_of(layout, text) or (1,)) for text in texts)


def shape_of(layout: ResultLayout, text: str) -> Shape | None:
    """Find the smallest shape of a quantity in any method; None where it is not known."""
    kind, name, _ = _read(layout, text)
    if kind in ("nees", "nis"):
        return ()
    if kind == "series":
        return layout.series[name]
    if kind == "recorded":
        wanted = OUTPUT if name == ERROR and ERROR not in layout.signal_names else name
        shapes = [signals[wanted] for signals in layout.signals.values() if wanted in signals]
    else:
        shapes = [_states(layout, method) for method in methods_with(layout, text)]
    known = [shape for shape in shapes if shape is not None]
    return min(known, key=math.prod) if known and len(known) == len(shapes) else None


def _states(layout: ResultLayout, method: str) -> Shape | None:
    """The shape of the state of a method's errors."""
    arrays, signals = layout.arrays.get(method, {}), layout.signals.get(method, {})
    sizes = [arrays[name][1:2] for name in (MEAN, MEAN_ESTIMATE, "M", COVARIANCE) if name in arrays]
    return next(iter(sizes), signals.get("x"))


def _index(component: str, shape: Shape, kind: str) -> int | None:
    """Position of a component, counted row by row; None where there is none."""
    parts = component.split(",")
    if not all(part.isdecimal() for part in parts):
        return None
    if len(parts) == 1 and kind != "series":
        return int(component) if int(component) < math.prod(shape) else None
    index = tuple(map(int, parts))
    if len(index) != len(shape) or any(i >= n for i, n in zip(index, shape, strict=True)):
        return None
    return int(np.ravel_multi_index(index, shape))


def _has(layout: ResultLayout, method: str, kind: str, name: str) -> bool:
    """Whether a method has what a quantity is made of."""
    signals, arrays = layout.signals.get(method, {}), layout.arrays.get(method, {})
    with_errors = {"x", "x_hat"} <= {*signals} or {MEAN, SCATTER} <= {*arrays}
    if kind == "recorded":
        return name in signals or (name == ERROR and OUTPUT in signals)
    if kind == "tube":
        # The reported set must be one of the plant's states.
        of_states = (shape := reported_set(arrays)) is not None and signals.get("x") in (None, shape[-1:])
        return {"x", "x_hat"} <= {*signals} and of_states
    return {
        "error": with_errors,
        "variance": SCATTER in arrays,
        "mean": {MEAN_STATE, MEAN_ESTIMATE} <= {*arrays},
        "nees": with_errors and (COVARIANCE in arrays or COVARIANCE in signals),
        "nis": {INNOVATION, INNOVATION_COVARIANCE} <= {*signals},
    }[kind]
