"""Co-simulation units (FMU) of version 2 and 3: the variables of a file, and instances of it."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import cache
from typing import Any

from rmpc_bench.components.process_directory import process_directory
from rmpc_bench.extras import library

REAL = ("Real", "Float64")
"""Types of variables that have numbers in double precision, of version 2 and 3."""


@dataclass(frozen=True)
class Unit:
    """A file and the numbers by which it calls its variables; it can be sent to a worker process.

    Parameters
    ----------
    path : of the file
    version : 2 or 3
    at_start : names of parameters, and of the states whose start is set, in the order of `start_references`
    """

    path: str
    version: int
    at_start: tuple[str, ...]
    start_references: tuple[int, ...]
    inputs: tuple[int, ...]
    read: tuple[int, ...]
    """States, then outputs."""

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
    fmpy = library("fmu")
    found = fmpy.read_model_description(path)
    directory = fmpy.extract(path, process_directory("rmpc-bench-fmu"))
    version = library("fmu", "fmi2").FMU2Slave if found.fmiVersion == "2.0" else library("fmu", "fmi3").FMU3Slave
    identifier = found.coSimulation.modelIdentifier
    return version(guid=found.guid, unzipDirectory=str(directory), modelIdentifier=identifier, instanceName="run")
