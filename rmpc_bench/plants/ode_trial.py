"""Trial runs of a differential equation: the range of every state, and the steps that error control takes.

Four runs go from the initial state over the whole horizon, with nominal parameters and no noise.  Two have inputs that
are held for a tenth of it, one has new inputs at every sample, and one has those at the middle of their bounds.  Inputs
are uniform between their bounds, and standard normal without bounds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.plants.ode_checks import inputs
from rmpc_bench.plants.ode_events import UserEvent
from rmpc_bench.plants.ode_stepping import (
    RunAdvance,
    Solver,
    Stepping,
    advance_block,
    advance_run,
    judged,
    rough_remark,
)
from rmpc_bench.types import Array, DesignError, Ode, Status

RUNS = 4
MAX_STEPS = 10_000
"""Steps of the trial runs after which they end, so that a plant with a long horizon is checked within seconds."""
COARSE, FINE = 1e-4, 1e-9
"""Tolerances with which the ranges are found, and with which a given number of steps is compared."""
SMALL = 1e-6
"""Error relative to the range of a state up to which a given number of steps is not remarked."""
MAX_EQUAL_STEPS = 50
"""Of code that takes equal steps: an equation with jumps or kinks has no number that is enough."""
GROWTH = 1e6
"""Range relative to that of the first tenth of the horizon at which a state is taken to grow without limit."""


class Trial(NamedTuple):
    """States and steps of the trial runs; NaN after a run has failed."""

    x: Float[Array, "runs samples nx"]
    steps: Int[Array, "runs samples"]
    rough: dict[int, int]
    """A state that jumps or has a kink, and the sample in which it does so first."""
    failures: list[str]
    """Why runs could not be integrated."""


def scale_of(ode: Ode, Ts: float, n_steps: int, x0: Float[Array, " nx"]) -> Float[Array, " nx"]:
    """Return the range of every state; where it grows without limit, its range until then."""
    x = simulated(ode, Ts, n_steps, x0, Stepping(Solver(rtol=COARSE), 0, np.zeros(ode.nx), finds_ranges=True)).x
    with np.errstate(all="ignore"):
        high, low = np.fmax.accumulate(np.fmax.reduce(x), axis=0), np.fmin.accumulate(np.fmin.reduce(x), axis=0)
        early = (high - low)[_tenth(n_steps)]
        found = np.where((early == 0.0) | (high - low <= GROWTH * early), high - low, 0.0).max(axis=0)
    return np.asarray(np.where(np.isfinite(found), found, 0.0))


def tried(
    ode: Ode, Ts: float, n_steps: int, x0: Float[Array, " nx"], solver: Solver, events: tuple[UserEvent, ...]
) -> tuple[Stepping, list[str]]:
    """Return the integration by rk4, and what the trial runs show of it."""
    stepping = Stepping(solver, solver.substeps or 0, scale_of(ode, Ts, n_steps, x0), events)
    given = simulated(ode, Ts, n_steps, x0, stepping)
    if stepping.substeps:
        right = simulated(ode, Ts, n_steps, x0, stepping._replace(solver=Solver(rtol=FINE), substeps=0)).x
        off = np.nan_to_num(np.abs(given.x - right) / stepping.scale, posinf=0.0).max(axis=(0, 1))
        i = int(off.argmax())
        text = f"{ode.states[i]} is off by {off[i]:.1g} of its range in the trial runs"
        steps = f"{stepping.substeps} substep{'s' if stepping.substeps > 1 else ''} of rk4"
        return stepping, [f"with {steps} {text}; leave `substeps` out to control the error"] if off[i] > SMALL else []
    if len(given.failures) == RUNS and np.isnan(given.x[:, 1]).all():
        raise DesignError(given.failures[0], "solver")
    runs, samples = np.nonzero(np.isfinite(given.x[:, 1:]).all(axis=2))
    done = given.steps[runs, samples]
    most, mean = (int(done.max()), done.mean()) if len(done) else (0, 0.0)
    t = samples[done.argmax()] * Ts if len(done) else 0.0
    remarks = [f"rk4 with error control: {mean:.1f} steps per sample, at most {most} at t = {t:.6g} s (trial runs)"]
    remarks += [rough_remark(ode, state, k) for state, k in given.rough.items()]
    remarks += [f"a trial run has failed: {reason}" for reason in given.failures[:1]]
    # About half of the steps are kept; the others estimate the error.
    return stepping._replace(equal_steps=min((most + 1) // 2, MAX_EQUAL_STEPS)), remarks


def simulated(ode: Ode, Ts: float, n_steps: int, x0: Float[Array, " nx"], stepping: Stepping) -> Trial:
    """Simulate the trial runs, at most until `MAX_STEPS`."""
    u = _inputs(ode, n_steps)
    trial = Trial(np.full((RUNS, n_steps + 1, ode.nx), np.nan), np.zeros((RUNS, n_steps), dtype=int), {}, [])
    trial.x[:, 0], alive, spent = x0, list(range(RUNS)), 0
    for k in range(n_steps):
        try:
            ends = _advanced(ode, Ts, stepping, k, trial.x[alive, k], u[alive, k])
        # The functions are the user's: they may raise anything where a trial run has come to.
        except Exception:
            break
        for i, end in zip(alive, ends, strict=True):
            if end.status == Status.OK:
                trial.x[i, k + 1], trial.steps[i, k] = end.x, end.steps
            elif end.status == Status.NOT_CONVERGED:
                trial.failures.append(end.reason)
            if end.rough >= 0:
                trial.rough.setdefault(end.rough, k)
        alive = [i for i in alive if np.isfinite(trial.x[i, k + 1]).all()]
        # A step of a block is as expensive as that of one run.
        spent += max(stepping.substeps, int(trial.steps[:, k].max())) * (1 if ode.rhs_takes_blocks else RUNS)
        if not alive or spent > MAX_STEPS:
            break
    return trial


def _advanced(ode: Ode, Ts: float, stepping: Stepping, k: int, x: Array, u: Array) -> list[RunAdvance]:
    if ode.rhs_takes_blocks:
        numbers = np.tile(list(ode.nominal.values()), (len(x), 1))
        end = advance_block(ode, Ts, stepping, k, x, u, numbers)
        return [judged(ode, end, i, u[i]) for i in range(len(x))]
    return [advance_run(ode, Ts, stepping, k, row, given, ode.p) for row, given in zip(x, u, strict=True)]


def _inputs(ode: Ode, n_steps: int) -> Float[Array, "runs samples nu"]:
    u = inputs(ode, np.random.Generator(np.random.PCG64(11)), (RUNS, n_steps))
    tenth = _tenth(n_steps)
    u[:2] = u[:2, np.arange(n_steps) // tenth * tenth]
    low, high = ode.limits(ode.inputs)
    u[3] = np.clip(np.where(np.isfinite(low + high), (low + high) / 2, 0.0), low, high)
    return u


def _tenth(n_steps: int) -> int:
    return -(-n_steps // 10)
