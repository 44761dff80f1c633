"""The metric that picks one number out of a trajectory."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.estimates import estimate_error, first_estimates, refuse_other_states
from rmpc_bench.metrics.tracking import SampleMetric, Units, Window
from rmpc_bench.types import Array, DesignError, MetricInfo, NonNegative, Record


@dataclass(frozen=True)
class Component:
    """One component of a signal: parameters of `sample`."""

    signal: str
    index: int

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Its value at the only sample of the window."""
        values: Array = -estimate_error(record) if self.signal == "e" else getattr(record, self.signal)
        self.refuse_beyond(values.shape[2])
        return np.array(values[:, window.first, self.index])  # a copy, which does not keep the trajectories alive

    def refuse_beyond(self, n: int, of: str = "") -> None:
        """Insist that the signal has the component."""
        if self.index >= n:
            known = f"{self.signal}.0" if n == 1 else f"{self.signal}.0 to {self.signal}.{n - 1}"
            raise DesignError(f"there is no {self.signal}.{self.index}{of}: choose {known} (they count from 0)", "of")


def sample(units: Units, *, name: str = "sample", of: str, at: NonNegative | Literal["N"] = "N") -> SampleMetric:
    """Value of one component of a signal at one sample; the one nearer to 0 is better.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    of : x.I (true state), x_hat.I (estimate), e.I (x - x_hat), y.I (true output) or u.I (applied input); the
        components I count from 0
    at : the sample (seconds or samples, as `time`); N is the last one of the experiment, which for u is N-1
    """
    component = _component(of)
    _refuse_missing(units, component)
    last = units.n_steps - (component.signal == "u")  # no input is applied at k = N
    k = last if at == "N" else round(float(at) / units.tick)
    k = min(k, last) if units.cut else k
    if k > last:
        raise DesignError(f"{of} at sample {k} lies beyond the last one, {last}", "at")
    unit = {"y": units.y, "u": units.u}.get(component.signal, "")
    return SampleMetric(MetricInfo(name, unit, "zero"), Window(k, k), component)


def _component(of: str) -> Component:
    found = re.fullmatch(r"(x|x_hat|e|y|u)\.([0-9]+)", of)
    if found is None:
        raise DesignError(f"must be x.I, x_hat.I, e.I, y.I or u.I with a component I from 0 on (got {of!r})", "of")
    return Component(found[1], int(found[2]))


def _refuse_missing(units: Units, component: Component) -> None:
    """Refuse a component that the plant or a method does not have, where they are known."""
    plant = units.plant
    if plant is None:
        return
    if component.signal == "x_hat":
        for name, estimate in first_estimates(plant, units.methods):
            component.refuse_beyond(estimate.x_hat.shape[1], f" of method {name!r}")
        return
    if component.signal == "e":
        refuse_other_states(plant, units.methods, "of")
    component.refuse_beyond({"x": plant.nx, "e": plant.nx, "y": plant.ny, "u": plant.nu}[component.signal])
