"""Co-simulation units (FMU) of version 2 and 3 as plants, by fmpy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rmpc_bench.adapters.fmu_file import described
from rmpc_bench.adapters.fmu_plant import FmuPlant, FmuRun
from rmpc_bench.models.ode_functions import Names, names_of, refuse_shared
from rmpc_bench.plants.ode_design import bounds_by_name
from rmpc_bench.types import DataFiles, DesignError, Parameters, Signals


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
    the file allows to set their start values, else from its own.  There is no process noise, since the state inside
    the FMU cannot be changed.  Every run has its own instance.

    Parameters
    ----------
    Ts : sampling time [s], which is the communication step
    n_steps : number of control periods N
    fmu : the file; its content is part of the hash of the experiment
    states, inputs, outputs : names of variables, such as ``[h1, h2]`` or ``{pump: ml/s}`` (default of outputs: states)
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
    unit, about = described(fmu, signals, [*nominal], variables or {}, float(Ts))
    made = FmuPlant(unit, signals, nominal, float(Ts), n_steps)
    _try(made, np.broadcast_to(np.asarray(0.0 if x0 is None else x0, dtype=float), (len(x),)))
    own = " (x(0) is that of the FMU)" if made.has_own_start else ""
    texts = {"states": ", ".join(x) + own, "inputs": ", ".join(u) or "none", "outputs": ", ".join(y)}
    made.described = (("FMU", about), *texts.items())
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
