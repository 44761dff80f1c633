"""A plant of co-simulation units, one per run and method."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from rmpc_bench.adapters.fmu_file import Unit
from rmpc_bench.components.single_plant import ObjectPlant
from rmpc_bench.types import Array, OutOfRange, Parameters, Signals


class FmuRun:
    """The instance of one run; an error of the FMU is an exception, which ends the run."""

    def __init__(self, unit: Unit, signals: Signals, Ts: float) -> None:
        self.unit, self.signals, self.Ts = unit, signals, Ts

    def start(self, p: Parameters, x0: Float[Array, " nx"]) -> None:
        """Make the instance."""
        first = dict(zip(self.signals.states, x0.tolist(), strict=True))
        self.fmu = self.unit.instance({**first, **{name: p[name] for name in p}})
        second = self.unit.version == 2
        self.set = self.fmu.setReal if second else self.fmu.setFloat64
        self.get = self.fmu.getReal if second else self.fmu.getFloat64
        self.time = -self.Ts
        self._read()

    def step(self, u: Float[Array, " nu"], k: int) -> Float[Array, " nx"]:
        """Set the inputs, which the FMU holds, and simulate one sample."""
        if self.unit.inputs:
            self.set(self.unit.inputs, u)
        ended = self.fmu.doStep(k * self.Ts, self.Ts)
        if ended is not None and ended[1]:
            raise OutOfRange("the FMU has ended the simulation")
        self._read()
        end = (k + 1) * self.Ts
        now = self.time if ended is None else ended[3]
        if abs(now - end) > 1e-6 * self.Ts + 1e-9 * end:
            step = "`time.step` must be a multiple of its internal step"
            raise ValueError(f"after the step to t = {end:g} s the clock of the FMU is at {now:g} s; {step}")
        return self.x

    def output(self) -> Float[Array, " ny"]:
        """Return the outputs at the end of the last sample."""
        return self.y

    def _read(self) -> None:
        values, nx, ny = np.array(self.get(self.unit.read)), self.signals.nx, self.signals.ny
        self.x, self.y, clock = values[:nx], values[nx : nx + ny], values[nx + ny :]
        self.time = float(clock[0]) if len(clock) else self.time + self.Ts

    def __del__(self) -> None:
        """Free the instance; the library stays loaded for the other runs."""
        fmu = getattr(self, "fmu", None)
        if fmu is not None:
            (fmu.fmi2FreeInstance if self.unit.version == 2 else fmu.fmi3FreeInstance)(fmu.component)


class FmuPlant(ObjectPlant):
    """Co-simulation units; build it with `rmpc_bench.adapters.fmu.plant`."""

    def __init__(self, unit: Unit, signals: Signals, nominal: Mapping[str, float], Ts: float, n_steps: int) -> None:
        given = {"unit": unit, "signals": signals, "Ts": Ts, "n_steps": n_steps}
        own_start = not set(signals.states) <= set(unit.at_start)
        super().__init__(FmuRun, given, signals, nominal, nw=0, has_own_start=own_start)
        self.unit = unit
