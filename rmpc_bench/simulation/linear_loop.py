"""Compiled simulation of a whole period, where plant, filter and control law allow it.

It applies to built-in plants with compiled steps, filters with precomputed gains and linear control laws, and gives the
numbers of `closed_loop.simulate`, bit for bit.  Everything else is simulated step by step.
"""

from __future__ import annotations

import sys
from collections.abc import Collection
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_compiled, at_sample, mv
from rmpc_bench.simulation.checked_calls import is_own
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.simulation.scenario import Draws, Experiment
from rmpc_bench.simulation.state_range import DEFAULT_RANGE, LARGEST, OK, RunLimits, StateRange
from rmpc_bench.types import (
    DISTURBANCES,
    Array,
    CompiledFilter,
    CompiledLaw,
    CompiledPlant,
    Method,
    Plant,
    Record,
    Statuses,
    StepFunction,
    Term,
)

LEAST_WORK = 1_000_000
"""Runs times samples times methods for which numba is loaded: two seconds of the simulation step by step."""


def applies(experiment: Experiment, method: Method) -> bool:
    """Whether the compiled simulation is worth its import and gives the numbers of the simulation step by step."""
    parts = (experiment.plant, method.estimator, method.controller)
    if any(map(is_own, parts)) or not all(part.has_compiled_form for part in parts) or experiment.plant.limits_inputs:
        return False
    if experiment.plant.feedthrough or method.estimator.fed is not None:
        return False
    if experiment.scenario.input or method.delay.input or method.period is not None:
        return False
    size = experiment.n_runs * experiment.n_steps * len(experiment.methods)
    if size < LEAST_WORK and "numba" not in sys.modules:
        return False
    return adds_like_einsum()


@cache
def adds_like_einsum() -> bool:
    """Whether np.einsum of this processor adds in the order of the compiled sums, tried out on some products.

    It does on all processors whose vectors have two numbers and no fused multiply-add in NumPy's common code.
    """
    for m in (1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 30):
        # Roots of numbers without a square factor: every sum rounds.
        A, x = np.sqrt(np.arange(1.0, 3 * m + 1)).reshape(3, m), 1.0 / np.sqrt(np.arange(3.0, 2 * m + 3)).reshape(2, m)
        if not np.array_equal(compiled_products(A, x), mv(A, x)):
            return False
    return True


def compiled_products(A: Float[Array, "*runs n m"], x: Float[Array, "runs m"]) -> Float[Array, "runs n"]:
    """Multiply every row of ``x`` by a shared or a per-run matrix, as the compiled simulation does."""
    from rmpc_bench.numerics import linear_loop_kernel as kernel
    from rmpc_bench.simulation.loop_program import NONE, Program

    p, terms = Program(), [Term("x", (A[None] if A.ndim == 2 else A[:, None],))]
    rows = p.rows(np.zeros(x.shape[1]))
    p.own_matrices(terms)
    y, found = p.total((1, rows, *terms[0].matrices)), np.empty((len(x), 1, A.shape[-2]))
    layout = {kernel.X: rows.at, kernel.Y: y.at, kernel.MEASURED: len(p.operations)}
    status = np.zeros(len(x), np.int8)
    p.run(layout, (x[:, None], *(NONE,) * 4), (NONE, found, *(NONE,) * 3), status, status)
    return found[:, 0]


def warm_up(experiment: Experiment, method: Method) -> None:
    """Compile what the runs of a method use, or load it from the cache."""
    if applies(experiment, method):
        from rmpc_bench.numerics.linear_loop_kernel import LOOP, loop_kernel, ready

        ready(loop_kernel, LOOP)


def compiled_loop(
    plant: Plant,
    method: Method,
    draws: Draws,
    r: Float[Array, "known ny"],
    n_steps: int,
    *,
    with_P: bool = False,
    with_M: bool = False,
    info: Collection[str] = (),
    state_range: StateRange = DEFAULT_RANGE,
    start: RunStart | None = None,
    needed: Collection[str] = ("x", "x_hat", "u"),
) -> tuple[Record, Statuses] | None:
    """Simulate all runs of ``draws`` as `closed_loop.simulate` does, of a plant without bounds of its inputs.

    None where a law alters the measurements, where some are missing that the filter bridges, or where the design model
    has late ones.  Signals other than y have no rows unless they are needed.
    """
    if draws.alterations or any(method.delay.measurement or ()):
        return None
    runs = start.runs if start is not None else tuple(range(len(draws.x0)))
    compiled, law = plant.compiled_form(draws.delta, n_steps), method.controller.compiled_form(r, n_steps, runs)
    filter_ = method.estimator.compiled_form()
    x0 = plant.first_state(draws.delta, draws.x0)
    w, v = plant.mix(draws.delta, draws.w, draws.v) if plant.mixes_noise else (draws.w, draws.v)
    if method.estimator.bridges_missing and np.isnan(v).any():
        return None
    known = r[: n_steps + 1].copy()
    limits = RunLimits(state_range, x0, known)
    nd = method.n_disturbances
    of_estimates = limits.of_estimates((len(x0), len(filter_.schedule.x0)), nd)
    needed = {"y", *needed, *({"x_hat"} if DISTURBANCES in info else ()), *({"e"} & set(info))}
    signals, status = _simulated(plant, compiled, filter_, law, limits, of_estimates, x0, w, v, n_steps, needed)
    if method.estimator.bridges_missing and np.isnan(signals["y"]).any():
        return None
    matrices = {"P": with_P, "M": with_M}
    P, M = (_over_time(getattr(method.estimator, name), n_steps) if want else None for name, want in matrices.items())
    x, y, x_hat, u = (signals[name] for name in ("x", "y", "x_hat", "u"))
    reported = _reported(signals, filter_, info)
    if nd:
        # Contiguous, so that sums over time are those of the simulation step by step.
        reported |= {DISTURBANCES: np.ascontiguousarray(x_hat[:, :, -nd:])} if DISTURBANCES in info else {}
        x_hat = np.ascontiguousarray(x_hat[:, :, :-nd])
        P, M = (None if each is None else np.ascontiguousarray(each[:, :-nd, :-nd]) for each in (P, M))
    record = Record(plant.Ts, x, y, x_hat, u, known, P, M, method.controller, bursts=draws.bursts)
    return record._replace(info=reported, delta=draws.delta), status


def _simulated(
    plant: Plant,
    compiled: CompiledPlant,
    filter_: CompiledFilter,
    law: CompiledLaw,
    limits: RunLimits,
    of_estimates: Float[Array, "runs _"],
    x0: Float[Array, "runs nx"],
    w: Float[Array, "runs samples nw"],
    v: Float[Array, "runs samples ny"],
    n_steps: int,
    needed: Collection[str],
) -> tuple[dict[str, Array], Statuses]:
    """Call the kernel; return x, y, x_hat, u and e (runs, samples, n), and the statuses."""
    from rmpc_bench.numerics.linear_loop_kernel import N_STEPS
    from rmpc_bench.simulation.loop_program import NO_STEP, NONE, loop_program

    n_runs, nx, nu, ny, nh = len(x0), plant.nx, plant.nu, plant.ny, len(filter_.schedule.x0)
    program, layout = loop_program(compiled, filter_, law, (nx, nu, ny, w.shape[2]), limits)
    shapes = {name: (n_steps + 1, n) for name, n in (("x", nx), ("y", ny), ("x_hat", nh))}
    shapes |= {"u": (n_steps, nu), "e": (n_steps + 1, ny)}
    signals = {name: np.empty((n_runs if name in needed else 0, *shape)) for name, shape in shapes.items()}
    # |u| < LARGEST is the same as |u| <= the number below it.
    of_u = np.full((n_runs, nu), np.nextafter(LARGEST, 0.0))
    most = np.concatenate([np.broadcast_to(of_estimates, (n_runs, nh)), of_u, limits.of_x], axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        status = limits.of_state(np.full(n_runs, OK), np.full(n_runs, OK), x0)
    status = np.array(status, dtype=np.int8)
    noises = (noise if as_compiled(noise).view(np.int64).any() else NONE for noise in (w, v))
    inputs = (x0[:, None], most[:, None], *noises, law.given if len(law.given) > 1 else NONE)
    step = compiled.step if isinstance(compiled.step, StepFunction) else NO_STEP
    widths = nx, nu, w.shape[2]
    program.run(layout | {N_STEPS: n_steps}, inputs, tuple(signals.values()), status, compiled.status, widths, step)
    return signals, status


def _over_time(matrices: Array | None, n_steps: int) -> Array | None:
    """Return the matrix of every sample, (samples, n, n)."""
    return None if matrices is None else np.array([at_sample(matrices, k) for k in range(n_steps + 1)])


def _reported(signals: dict[str, Array], filter_: CompiledFilter, info: Collection[str]) -> dict[str, Any]:
    """Return the wanted signals that the filter reports, (runs, samples, n)."""
    found: dict[str, Any] = {}
    if "e" in info:
        found["e"] = signals["e"]
    if "S" in info and filter_.S is not None:
        n_runs, samples = signals["y"].shape[:2]
        S = _over_time(filter_.S, samples - 1)
        assert S is not None
        found["S"] = np.array(np.broadcast_to(S.reshape(1, samples, -1), (n_runs, samples, S[0].size)))
    return found
