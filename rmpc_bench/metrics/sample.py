"""Metric of the value of a signal at one sample."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.estimate_checks import check_state_lengths, estimate_error, first_estimates
from rmpc_bench.types import (
    Array,
    DesignError,
    Direction,
    Issue,
    Metric,
    MetricLayout,
    NonNegative,
    Record,
    SampleWindow,
    issues_of,
)


@dataclass(frozen=True)
class SignalComponent:
    """One component of a signal, such as ``x_hat.2``."""

    signal: str
    index: int

    def check(self, n: int, of: str = "") -> None:
        """Raise a DesignError where the signal, which has n components, does not have this one."""
        if self.index >= n:
            known = f"{self.signal}.0" if n == 1 else f"{self.signal}.0 to {self.signal}.{n - 1}"
            raise DesignError(f"there is no {self.signal}.{self.index}{of}: choose {known} (they count from 0)", "of")


def signal_component(of: str) -> SignalComponent:
    """Read the name of a component; a DesignError where the text names none."""
    found = re.fullmatch(r"(x|x_hat|e|y|u|u_command)\.([0-9]+)", of)
    if found is None:
        raise DesignError(f"must be x.I, x_hat.I, e.I, y.I, u.I or u_command.I, I from 0 on (got {of!r})", "of")
    return SignalComponent(found[1], int(found[2]))


@dataclass(frozen=True, kw_only=True)
class Sample(Metric):
    """Value of one component of a signal at one sample; the value closest to 0 is best.

    Parameters
    ----------
    of : x.I (true state), x_hat.I (estimate), e.I (x - x_hat), y.I (true output), u.I (applied input) or u_command.I
        (before the bounds of the plant), I from 0
    at : the sample, in seconds or samples as `time` of the experiment; `N` is the last one, which is N-1 for u

    Examples
    --------
    >>> Sample(of="x.0", at=1.0).evaluate(Record.of_run(x=[5.0, 7.0, 9.0])).item()
    7.0
    """

    name: str = "sample"
    of: str
    at: NonNegative | Literal["N"] = "N"

    better: ClassVar[Direction] = "zero"

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find a signal, a component or a sample that does not exist."""
        issues = [*issues_of(signal_component, self.of)]
        if not issues:
            issues = [*self._missing(layout, signal_component(self.of)), *super().check(layout)]
        yield from issues

    def _missing(self, layout: MetricLayout, component: SignalComponent) -> Iterator[Issue]:
        """Find a component that the plant or a method does not have, where they are known."""
        plant = layout.plant
        if plant is None:
            return
        if component.signal == "x_hat":
            for name, estimate in first_estimates(layout):
                yield from issues_of(component.check, estimate.x_hat.shape[1], f" of method {name!r}")
            return
        if component.signal == "e":
            yield from check_state_lengths(layout, "of")
        n = {"x": plant.nx, "e": plant.nx, "y": plant.ny, "u": plant.nu}[component.signal[0]]
        yield from issues_of(component.check, n)

    def unit(self, layout: MetricLayout) -> str:
        """Return the unit of the output or the input; states have none."""
        return {"y": layout.y_unit, "u": layout.u_unit}.get(signal_component(self.of).signal[0], "")

    def window(self, layout: MetricLayout) -> SampleWindow:
        """Return the only sample that it reads."""
        # No input is applied at k = N.
        last = layout.n_steps - 1 if signal_component(self.of).signal[0] == "u" else layout.n_steps
        k = last if self.at == "N" else layout.sample(self.at, "at")
        k = min(k, last) if layout.cut else k
        if k > last:
            raise DesignError(f"{self.of} at sample {k} lies beyond the last one, {last}", "at")
        return SampleWindow(k, k)

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Read the sample."""
        component, k = signal_component(self.of), self.samples(record).first
        values: Array = -estimate_error(record) if component.signal == "e" else getattr(record, component.signal)
        component.check(values.shape[2])
        # A copy, because a view would keep all trajectories in memory.
        return np.array(values[:, k, component.index])
