"""Number of Runge-Kutta steps per sample of a differential equation.

Trial runs start at the initial state with nominal parameters and no noise.  Their inputs are drawn anew at every
sample: uniform between their bounds, standard normal without bounds.  The number of steps is the smallest one found for
which twice as many steps change no sampled state by more than 1e-9 of its range over the trial runs.  An equation with
jumps or kinks has no such number; it gets 50 steps and a remark with its change.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil

import numpy as np
from jaxtyping import Float

from rmpc_bench.plants.ode_checks import inputs
from rmpc_bench.plants.ode_stepping import Solver, Stepping, advance_block, advance_run
from rmpc_bench.types import Array, DesignError, Ode, Status

SHORT = (2, 5)
"""Trial runs and their samples at most, with which the number of steps is searched."""
LARGEST_CHANGE = 1e-9
"""Of a sampled state, relative to its range."""
ROUNDING = 1e-13
"""Change relative to the magnitude of a state that rounding explains."""
MAX_SUBSTEPS = 200
"""Beyond this number the equation is stiff, and an implicit method is cheaper."""
ROUGH_SUBSTEPS, ROUGH_CHANGE = 50, 0.02
"""Number of steps where no number is enough although the solution is no worse than this, relative to the range of a
state: the equation has a jump or a kink, such as dry friction."""
ORDER = 4
"""Of the Runge-Kutta method."""

Trial = Callable[[tuple[int, int], int], Array]
"""States of trial runs: runs and samples, number of steps -> (runs, samples, nx), NaN after a run has failed."""


def choose_substeps(ode: Ode, Ts: float, n_steps: int, x0: Float[Array, " nx"]) -> int:
    """Return the number of steps.

    Parameters
    ----------
    ode : the equation; whether it takes blocks is known
    Ts : sampling time [s]
    n_steps : number of control periods N
    x0 : initial state

    Raises
    ------
    DesignError
        If it would have to be more than `MAX_SUBSTEPS`.
    """
    trial = trial_runs(ode, Ts, n_steps, x0)
    first = _search(trial)
    coarse = trial(full(ode), first) if first <= MAX_SUBSTEPS else None
    for n in [first * factor for factor in (1, 2, 4) if first * factor <= MAX_SUBSTEPS]:
        fine = trial(full(ode), 2 * n)
        if coarse is not None and change(coarse, fine)[0] <= 1.0:
            return n
        coarse = fine
    if change(trial(SHORT, MAX_SUBSTEPS), trial(SHORT, 2 * MAX_SUBSTEPS))[0] <= 1.0:
        return MAX_SUBSTEPS
    coarse, fine = trial(full(ode), ROUGH_SUBSTEPS), trial(full(ode), 2 * ROUGH_SUBSTEPS)
    if change(coarse, fine)[0] * LARGEST_CHANGE <= ROUGH_CHANGE:
        return ROUGH_SUBSTEPS
    raise DesignError(_stiff(ode, coarse, fine), "solver")


def _search(trial: Trial) -> int:
    """Return the number of steps for a few short trial runs; more than `MAX_SUBSTEPS` where those are too few."""
    n, coarse, before = 1, trial(SHORT, 1), np.inf
    while n <= MAX_SUBSTEPS:
        fine = trial(SHORT, 2 * n)
        error = change(coarse, fine)[0]
        if error <= 1.0:
            # The error falls with the fourth power of the step.
            guess = ceil(n / 2 * before ** (1 / ORDER)) if np.isfinite(before) else n
            good = n / 2 < guess < n and change(trial(SHORT, guess), trial(SHORT, 2 * guess))[0] <= 1.0
            return guess if good else n
        n, coarse, before = 2 * n, fine, error
    return n


def full(ode: Ode) -> tuple[int, int]:
    """Trial runs and their samples at most, of the verdict; fewer samples where every run is called by itself."""
    return (20, 20) if ode.rhs_takes_blocks else (20, 8)


def substeps_remark(ode: Ode, Ts: float, n_steps: int, x0: Float[Array, " nx"], solver: Solver, substeps: int) -> str:
    """Say what number of steps was chosen, or how far twice a given one changes the states; empty if not far."""
    if solver.substeps is None and substeps != ROUGH_SUBSTEPS:
        return f"rk4 takes {substeps} substeps per sample"
    trial = trial_runs(ode, Ts, n_steps, x0)
    coarse, fine = trial(full(ode), substeps), trial(full(ode), 2 * substeps)
    size, i = change(coarse, fine)
    if size <= 1.0:
        return "" if solver.substeps else f"rk4 takes {substeps} substeps per sample"
    text = f"twice as many substeps of rk4 as {substeps} change {ode.states[i]} by {_relative(coarse, fine, i)}"
    return text if solver.substeps else f"{text}, as where the equation has a jump or a kink; see solver"


def trial_runs(ode: Ode, Ts: float, n_steps: int, x0: Float[Array, " nx"]) -> Trial:
    """Return the function that simulates the trial runs."""
    u = inputs(ode, np.random.Generator(np.random.PCG64(11)), (20, 20))

    def trial(size: tuple[int, int], substeps: int) -> Array:
        n_runs, n_samples = size
        x, states = np.tile(x0, (n_runs, 1)), []
        for k in range(min(n_steps, n_samples)):
            x = _advance(ode, Ts, substeps, k, x, u[:n_runs, k])
            states.append(x)
        return np.stack(states, axis=1)

    return trial


def _advance(ode: Ode, Ts: float, substeps: int, k: int, x: Array, u: Array) -> Array:
    """Move to the next sample; NaN for a run that leaves its bounds."""
    if ode.rhs_takes_blocks:
        numbers = np.tile(list(ode.nominal.values()), (len(x), 1))
        found = advance_block(ode, Ts, substeps, k, x, u, numbers)
        return np.where(found.state[:, None] < 0, found.x.T, np.nan)
    stepping, ends = Stepping(Solver(), substeps), []
    for row, given in zip(x, u, strict=True):
        alive = bool(np.isfinite(row).all())
        end = advance_run(ode, Ts, stepping, k, row, given, ode.p) if alive else None
        ends.append(end.x if end is not None and end.status == Status.OK else np.full(ode.nx, np.nan))
    return np.stack(ends)


def change(coarse: Float[Array, "runs samples nx"], fine: Float[Array, "runs samples nx"]) -> tuple[float, int]:
    """Return the largest change of a state, relative to what is allowed, and the state.

    Samples at which both runs have ended are left out.  A run that ends with one number of steps only, or has a state
    that is not a number, counts as an infinite change.
    """
    allowed = LARGEST_CHANGE * _range(fine) + ROUNDING * _largest(fine)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        apart = np.abs(coarse - fine)
        apart[np.isnan(coarse) & np.isnan(fine)] = 0.0
        relative = np.where(apart > 0.0, apart / allowed, 0.0)
    relative[np.isnan(relative)] = np.inf
    if np.isnan(fine[:, 0]).all():
        # Nothing can be compared: too few steps, or no run survives a sample.
        return np.inf, 0
    worst = relative.max(axis=(0, 1))
    return float(worst.max()), int(worst.argmax())


def _range(states: Float[Array, "runs samples nx"]) -> Float[Array, " nx"]:
    high = np.where(np.isfinite(states), states, -np.inf).max(axis=(0, 1))
    low = np.where(np.isfinite(states), states, np.inf).min(axis=(0, 1))
    return np.asarray(np.maximum(high - low, 0.0))


def _largest(states: Float[Array, "runs samples nx"]) -> Float[Array, " nx"]:
    return np.asarray(np.abs(np.where(np.isfinite(states), states, 0.0)).max(axis=(0, 1)))


def _relative(coarse: Array, fine: Array, i: int) -> str:
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.nanmax(np.abs(coarse - fine)[..., i], initial=0.0)
        return f"{apart / _range(fine)[i]:.1g} of its range in the trial runs"


def _stiff(ode: Ode, coarse: Array, fine: Array) -> str:
    size, i = change(coarse, fine)
    found = f"{ode.states[i]} changes by {_relative(coarse, fine, i)} with twice as many"
    if not np.isfinite(size):
        found = "runs have no finite numbers, or leave their bounds"
    return (
        f"the differential equation is stiff: with {ROUGH_SUBSTEPS} steps of rk4 per sample {found}; more than "
        f"{MAX_SUBSTEPS} would be needed; use solver: {{method: LSODA}} or {{method: Radau}}, or give solver.substeps"
    )
