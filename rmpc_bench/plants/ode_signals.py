"""Signals of a differential equation besides its outputs, and its states between the samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.models.ode_functions import Names, function_name, is_fed, names_of, padded, rows
from rmpc_bench.plants.ode_design import initial, output_takes_blocks
from rmpc_bench.plants.ode_stepping import Stepping, advance_block, advance_run
from rmpc_bench.types import Array, DesignError, Ode, Parameters, SolverError

RECORDED = ("x_hat", "P", "e", "r", "bursts")
"""Names of other signals that are recorded or drawn."""
Rows = Float[Array, "runs n_parameters"]


def extra_equation(
    ode: Ode, function: Any, names: Names | None, x0: Float[Array, " nx"] | None
) -> tuple[Ode | None, tuple[str, ...]]:
    """Return the equation whose outputs are the extra signals, None where there are none, and remarks."""
    if function is None:
        if names is not None:
            raise DesignError(
                "name what a function returns; give `extra_signal`, or leave the names out", "extra_signals"
            )
        return None, ()
    if names is None:
        raise DesignError("name the extra signals", "extra_signals")
    is_fed(function, "extra_signal", allowed=False)
    found, units = names_of(names, "extra_signals", "z")
    used = [name for name in found if name in (*ode.states, *ode.inputs, *ode.outputs, *RECORDED)]
    if used:
        raise DesignError(f"{used[0]!r} is the name of another signal already", "extra_signals")
    extra = replace(ode, output=function, outputs=found, units=units, fed=False)
    # A function may meet numbers here for which it is not defined.
    with np.errstate(all="ignore"):
        reason = output_takes_blocks(extra, initial(ode, x0), "extra_signal")
    remarks = (f"{function_name(function)} is called run by run: {reason}",) if reason else ()
    return replace(extra, output_takes_blocks=not reason), remarks


def extra_values(
    extra: Ode, name: str, numbers: Rows, x: Float[Array, "runs samples nx"]
) -> Float[Array, "runs samples"]:
    """Return an extra signal at all samples of every run; the outputs of `extra` are the extra signals."""
    n_runs, n_samples, nx = x.shape
    place = extra.outputs.index(name)
    with np.errstate(all="ignore"):
        if extra.output_takes_blocks:
            p = rows(extra.nominal, padded(np.repeat(numbers, n_samples, axis=0)))
            flat = extra.measure(padded(x.reshape(-1, nx)), None, p)[place, : n_runs * n_samples]
            return np.ascontiguousarray(flat).reshape(n_runs, n_samples)
        found = np.full((n_runs, n_samples), np.nan)
        for i in range(n_runs):
            p = _of_run(extra, numbers, i)
            # A failed run may have states for which the function is not defined.
            for k in np.flatnonzero(np.isfinite(x[i]).all(axis=1)).tolist():
                found[i, k] = extra.measure(x[i, k], None, p)[place]
    return found


def states_between(
    ode: Ode,
    Ts: float,
    stepping: Stepping,
    numbers: Rows,
    x: Float[Array, "runs steps nx"],
    u: Float[Array, "runs steps nu"],
    parts: int,
    first: int,
    alive: Bool[Array, " runs"],
) -> Float[Array, "runs steps parts nx"]:
    """Integrate successive control periods from `first` on in equal parts, as the plant does over a sample.

    The inputs are within their bounds.  Runs that have failed keep their state.
    """
    shorter = stepping._replace(substeps=ceil(stepping.substeps / parts))
    states = np.empty((*x.shape[:2], parts, ode.nx))
    for k in range(x.shape[1]):
        now = x[:, k]
        for part in range(parts):
            now = _advanced(ode, Ts / parts, shorter, (first + k) * parts + part, now, u[:, k], numbers, alive)
            states[:, k, part] = now
    return states


def _advanced(
    ode: Ode, Ts: float, stepping: Stepping, k: int, x: Array, u: Array, numbers: Rows, alive: Bool[Array, " runs"]
) -> Float[Array, "runs nx"]:
    """Return the states a part of a period later."""
    rows = np.flatnonzero(alive)
    if ode.rhs_takes_blocks and stepping.in_blocks:
        try:
            moved = x.copy()
            moved[rows] = advance_block(ode, Ts, stepping, k, x[rows], u[rows], numbers[rows]).x.T
            return moved
        except SolverError:
            # A solver within rhs has failed in one of the runs.
            pass
    return _one_by_one(ode, Ts, stepping, k, x, u, numbers, rows.tolist())


def _one_by_one(
    ode: Ode, Ts: float, stepping: Stepping, k: int, x: Array, u: Array, numbers: Rows, runs: Iterable[int]
) -> Float[Array, "runs nx"]:
    end = x.copy()
    for i in runs:
        end[i] = advance_run(ode, Ts, stepping, k, x[i], u[i], _of_run(ode, numbers, i)).x
    return end


def _of_run(ode: Ode, numbers: Rows, i: int) -> Parameters:
    return Parameters(dict(zip(ode.nominal, numbers[i].tolist(), strict=True)))
