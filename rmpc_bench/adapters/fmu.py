"""Co-simulation units (FMU) of version 2 and 3 as plants, by fmpy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.components.single_plant import ObjectPlant
from rmpc_bench.components.transport import process_directory
from rmpc_bench.extras import library
from rmpc_bench.models.ode_functions import Names, names_of, refuse_shared
from rmpc_bench.plants.ode_design import bounds_by_name
from rmpc_bench.received.consent import refused
from rmpc_bench.types import Array, DataFiles, DesignError, OutOfRange, Parameters, Signals
from rmpc_bench.types.errors import unknown

REAL = ("Real", "Float64")
"""Types of variables that have numbers in double precision, of version 2 and 3."""


@dataclass(frozen=True)
class Unit:
    """A file and the numbers by which it calls its variables; it can be sent to a worker process.

    `at_start` has the names of parameters, and of the states whose start is set, in the order of `start_references`.
    """

    path: str
    version: int
    at_start: tuple[str, ...]
    start_references: tuple[int, ...]
    inputs: tuple[int, ...]
    read: tuple[int, ...]
    """States, outputs, and the time where a file of version 2 shows it; `doStep` of version 3 returns it."""

    def instance(self, start: Mapping[str, float]) -> Any:
        """Return a new instance after its initialisation at t = 0; all instances share the library of the file."""
        made = copy(loaded(self.path))
        made.instantiate()
        values = [start[name] for name in self.at_start]
        set_values, _ = self.calls(made)
        if self.version == 2:
            made.setupExperiment(startTime=0.0)
            set_values(self.start_references, values)
            made.enterInitializationMode()
        else:
            set_values(self.start_references, values)
            made.enterInitializationMode(startTime=0.0)
        made.exitInitializationMode()
        return made

    def calls(self, made: Any) -> tuple[Any, Any]:
        """Return what sets and what reads variables of an instance."""
        return (made.setReal, made.getReal) if self.version == 2 else (made.setFloat64, made.getFloat64)


@cache
def loaded(path: str) -> Any:
    """Extract a file into a temporary directory of this process, and load its library."""
    if reason := refused(path):
        raise DesignError(reason, "fmu")
    fmpy = library("fmu")
    found = fmpy.read_model_description(path)
    directory = fmpy.extract(path, process_directory("rmpc-bench-fmu"))
    version = library("fmu", "fmi2").FMU2Slave if found.fmiVersion == "2.0" else library("fmu", "fmi3").FMU3Slave
    identifier = found.coSimulation.modelIdentifier
    return version(guid=found.guid, unzipDirectory=str(directory), modelIdentifier=identifier, instanceName="run")


def _description(file: Path, Ts: float) -> Any:
    """Return what a file says of itself; a DesignError where the bench cannot simulate it with the sampling time."""
    fmpy = library("fmu")
    if reason := refused(str(file)):
        raise DesignError(reason, "fmu")
    try:
        found = fmpy.read_model_description(str(file))
    except Exception as error:
        raise DesignError(f"{file.name} is no FMU ({type(error).__name__}: {error})", "fmu") from error
    if found.coSimulation is None or found.fmiVersion not in ("2.0", "3.0"):
        raise DesignError(f"{file.name} is no co-simulation unit of FMI 2.0 or 3.0", "fmu")
    if found.coSimulation.canBeInstantiatedOnlyOncePerProcess:
        text = f"{file.name} allows one instance per process, and every run and method needs an instance"
        raise DesignError(text, "fmu")
    step = float(found.coSimulation.fixedInternalStepSize or Ts)
    if abs(Ts / step - round(Ts / step)) > 1e-6 * Ts / step or not round(Ts / step):
        text = f"{file.name} has the internal step {step:g} s (fixedInternalStepSize)"
        raise DesignError(f"{text}; `time.step`, {Ts:g} s, must be a multiple of it", "fmu")
    try:
        loaded(str(file))
    except DesignError:
        raise
    except Exception as error:
        raise DesignError(f"{file.name} cannot be loaded ({type(error).__name__}: {error})", "fmu") from error
    return found


def _unit(file: Path, found: Any, signals: Signals, p: Sequence[str], named: Mapping[str, str]) -> Unit:
    """Return a file with the variables that a plant uses."""
    known = {each.name: each for each in found.modelVariables}

    def all_of(names: Sequence[str], key: str, causality: Sequence[str]) -> list[Any]:
        return [_variable(known, named.get(name, name), key, causality) for name in names]

    x = all_of(signals.states, "states", ("output", "local"))
    y = all_of(signals.outputs, "outputs", ("output", "local"))
    parameters = all_of(p, "parameters", ("parameter",))
    u = all_of(signals.inputs, "inputs", ("input",))
    clock = [each for each in found.modelVariables if each.causality == "independent" and each.type == "Real"][:1]
    settable = all(each.initial in ("exact", "approx") for each in x)
    at_start = [*zip(p, parameters, strict=True), *(zip(signals.states, x, strict=True) if settable else ())]
    return Unit(
        str(file),
        int(found.fmiVersion[0]),
        tuple(name for name, _ in at_start),
        tuple(each.valueReference for _, each in at_start),
        tuple(each.valueReference for each in u),
        tuple(each.valueReference for each in (*x, *y, *clock)),
    )


def _variable(known: Mapping[str, Any], name: str, key: str, causality: Sequence[str]) -> Any:
    """Return a variable by its name in the file."""
    if name not in known:
        raise DesignError(unknown(name, known, "variable of the FMU"), key)
    found = known[name]
    if found.type not in REAL or found.shape:
        raise DesignError(f"{name} is a variable of type {found.type}; only single numbers are supported", key)
    if found.causality not in causality:
        raise DesignError(f"{name} is a variable of causality {found.causality} (not {' or '.join(causality)})", key)
    return found


class FmuRun:
    """The instance of one run; an error of the FMU is an exception, which ends the run."""

    def __init__(self, unit: Unit, signals: Signals, Ts: float) -> None:
        self.unit, self.signals, self.Ts = unit, signals, Ts

    def start(self, p: Parameters, x0: Float[Array, " nx"]) -> None:
        """Make the instance."""
        first = dict(zip(self.signals.states, x0.tolist(), strict=True))
        self.fmu = self.unit.instance({**first, **{name: p[name] for name in p}})
        self.set, self.get = self.unit.calls(self.fmu)
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


def plant(
    Ts: float,
    n_steps: int,
    *,
    fmu: DataFiles,
    states: Names,
    inputs: Names = 0,
    outputs: Names | None = None,
    parameters: dict[str, float] | None = None,
    variables: dict[str, str] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    x0: Any = None,
) -> FmuPlant:
    """Co-simulation unit (FMU) of version 2 or 3.

    An FMU does not show its true state: x consists of the variables under `states`.  It starts from `initial.x` where
    the file allows that, else from its own start values.  There is no process noise.  Every run has its own instance.

    Parameters
    ----------
    Ts : sampling time [s], which is the communication step
    n_steps : number of control periods N
    fmu : the file; its content is part of the hash of the experiment
    states, inputs, outputs : variables, such as ``{pump: ml/s}`` (default of outputs: states)
    parameters : name of a parameter -> nominal value; `perturb` and `set` may name them
    variables : name -> name in the file, where it is another one, such as ``{h1: tank.level}``
    bounds : name of a state or an input -> lower and upper bound
    x0 : (nx,) initial state, from which the file is tried

    Raises
    ------
    DesignError
        If the file is no such unit, a variable is not there, or the first sample fails.
    """
    for key, given in (("states", states), ("inputs", inputs or []), ("outputs", outputs)):
        if isinstance(given, int):
            raise DesignError("must be names of variables of the FMU", key)
    x, units = names_of(states, "states", "x")
    u, u_units = names_of(inputs, "inputs", "u")
    y, y_units = (x, units) if outputs is None else names_of(outputs, "outputs", "y")
    refuse_shared(x, u)
    signals = Signals(x, u, y, {**y_units, **u_units, **units}, bounds_by_name(bounds or {}, x, u))
    nominal = {name: float(value) for name, value in (parameters or {}).items()}
    if len(fmu) != 1:
        raise DesignError(f"must be one file (got {len(fmu)})", "fmu")
    found = _description(fmu[0], float(Ts))
    unit = _unit(fmu[0], found, signals, [*nominal], variables or {})
    made = FmuPlant(unit, signals, nominal, float(Ts), n_steps)
    _try(made, np.broadcast_to(np.asarray(0.0 if x0 is None else x0, dtype=float), (len(x),)))
    own = " (x(0) is that of the FMU)" if made.has_own_start else ""
    about = f"{found.modelName}, FMI {found.fmiVersion}, one instance per run and method"
    texts = {"FMU": about, "states": ", ".join(x) + own, "inputs": ", ".join(u) or "none", "outputs": ", ".join(y)}
    made.described = tuple(texts.items())
    return made


def _try(made: FmuPlant, x0: Any) -> None:
    """Simulate one sample with nominal parameters."""
    signals: Any = made.signals
    run = FmuRun(made.unit, signals, made.Ts)
    try:
        run.start(Parameters(made.nominal), x0)
        first = run.x
        run.step(np.clip(0.0, *signals.limits(signals.inputs)), 0)
    except Exception as error:
        raise DesignError(f"the first sample fails ({type(error).__name__}: {error})", "fmu") from error
    if not made.has_own_start and not np.allclose(first, x0, rtol=1e-9, atol=0.0):
        raise DesignError(f"the FMU starts at {first.tolist()} in place of initial.x", "states")
