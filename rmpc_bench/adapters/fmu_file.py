"""Co-simulation units (FMU) of version 2 and 3: the variables of a file, and instances of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cache
from typing import Any

from rmpc_bench.components.transport import process_directory
from rmpc_bench.extras import library
from rmpc_bench.received.consent import refused
from rmpc_bench.types import DesignError, Signals
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
        set_values = made.setReal if self.version == 2 else made.setFloat64
        if self.version == 2:
            made.setupExperiment(startTime=0.0)
            set_values(self.start_references, values)
            made.enterInitializationMode()
        else:
            set_values(self.start_references, values)
            made.enterInitializationMode(startTime=0.0)
        made.exitInitializationMode()
        return made


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


def described(
    files: Sequence[Any], signals: Signals, p: Sequence[str], named: Mapping[str, str], Ts: float
) -> tuple[Unit, str]:
    """Return a file with the variables that a plant uses, and a text about it."""
    if len(files) != 1:
        raise DesignError(f"must be one file (got {len(files)})", "fmu")
    path, fmpy = str(files[0]), library("fmu")
    if reason := refused(path):
        raise DesignError(reason, "fmu")
    try:
        found = fmpy.read_model_description(path)
    except Exception as error:
        raise DesignError(f"{files[0].name} is no FMU ({type(error).__name__}: {error})", "fmu") from error
    if found.coSimulation is None or found.fmiVersion not in ("2.0", "3.0"):
        raise DesignError(f"{files[0].name} is no co-simulation unit of FMI 2.0 or 3.0", "fmu")
    if found.coSimulation.canBeInstantiatedOnlyOncePerProcess:
        text = f"{files[0].name} allows one instance per process, and every run and method needs an instance"
        raise DesignError(text, "fmu")
    step = float(found.coSimulation.fixedInternalStepSize or Ts)
    if abs(Ts / step - round(Ts / step)) > 1e-6 * Ts / step or not round(Ts / step):
        text = f"{files[0].name} has the internal step {step:g} s (fixedInternalStepSize)"
        raise DesignError(f"{text}; `time.step`, {Ts:g} s, must be a multiple of it", "fmu")
    try:
        loaded(path)
    except DesignError:
        raise
    except Exception as error:
        raise DesignError(f"{files[0].name} cannot be loaded ({type(error).__name__}: {error})", "fmu") from error
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
    unit = Unit(
        path,
        int(found.fmiVersion[0]),
        tuple(name for name, _ in at_start),
        tuple(each.valueReference for _, each in at_start),
        tuple(each.valueReference for each in u),
        tuple(each.valueReference for each in (*x, *y, *clock)),
    )
    return unit, f"{found.modelName}, FMI {found.fmiVersion}, one instance per run and method"


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
