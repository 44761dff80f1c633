"""Co-simulation units as plants: a step of the plant, and `doStep` of fmpy in a plain loop."""

import tempfile
from pathlib import Path

import numpy as np

from perf.row import Row

RUNS, STEPS, TS = 50, 100, 5.0
VARIABLES = {"h1": 0, "h2": 1, "pump": 2, "level": 6}
"""References of the variables of the test unit."""


def unit():
    """Compile the test unit of version 2 and return its file."""
    from adapters.fmu_units import build

    return build(Path(tempfile.mkdtemp()), 2)


def given():
    """Return the initial states of every run, and inputs (steps, runs, nu)."""
    rng = np.random.default_rng(0)
    return rng.uniform(0.1, 0.2, (RUNS, 2)), rng.uniform(5.0, 10.0, (STEPS, RUNS, 1))


def through_adapter():
    """Simulate the unit as a block of runs."""
    from adapters.fmu_units import NAMES

    from rmpc_bench.adapters.fmu import plant

    made, (x0, u) = plant(TS, STEPS, fmu=(unit(),), x0=[0.2, 0.1], **NAMES), given()

    def work():
        delta = made.start(made.draw({}, [None] * RUNS, STEPS), x0, None)
        x = x0
        for k in range(STEPS):
            x = made.step(k, delta, x, u[k], np.zeros((RUNS, 0))).x
        return x

    return work, RUNS * STEPS


def plain():
    """Simulate run after run by fmpy."""
    import fmpy
    from fmpy.fmi2 import FMU2Slave

    directory = fmpy.extract(str(unit()))
    about, (x0, u) = fmpy.read_model_description(directory), given()
    read = [VARIABLES[name] for name in ("h1", "h2", "level")]

    def one_run(run):
        made = FMU2Slave(guid=about.guid, unzipDirectory=directory, modelIdentifier="tanks", instanceName="plain")
        made.instantiate()
        made.setupExperiment(startTime=0.0)
        made.setReal([VARIABLES["h1"], VARIABLES["h2"]], x0[run])
        made.enterInitializationMode()
        made.exitInitializationMode()
        for k in range(STEPS):
            made.setReal([VARIABLES["pump"]], u[k, run])
            made.doStep(currentCommunicationPoint=k * TS, communicationStepSize=TS)
            values = made.getReal(read)
        made.fmi2FreeInstance(made.component)
        return values[:2]

    def work():
        return np.array([one_run(run) for run in range(RUNS)])

    return work, RUNS * STEPS


ROWS = [
    Row(
        "FMU of version 2 as plant",
        "run-step",
        through_adapter,
        plain,
        "`doStep` of fmpy in a plain loop",
        1e-12,
    )
]
