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
from rmpc_bench.simulation.state_range import DEFAULT_RANGE, OK, RunLimits, StateRange
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
)

LEAST_WORK = 1_000_000
"""Runs times samples times methods for which numba is loaded: two seconds of the simulation step by step."""


def applies(experiment: Experiment, method: Method) -> bool:
    """Whether the compiled simulation is worth its import and gives the numbers of the simulation step by step."""
    parts = (experiment.plant, method.estimator, method.controller)
    if any(map(is_own, parts)) or not all(part.has_compiled_form for part in parts) or experiment.plant.limits_inputs:
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
    from rmpc_bench.numerics.linear_loop_kernel import PRODUCT, product_kernel, ready

    for m in (1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 30):
        # Roots of numbers without a square factor: every sum rounds.
        A, x = np.sqrt(np.arange(1.0, 3 * m + 1)).reshape(3, m), 1.0 / np.sqrt(np.arange(3.0, 2 * m + 3)).reshape(2, m)
        found = np.empty((2, 3))
        ready(product_kernel, PRODUCT)(A.reshape(1, -1), x, found)
        if not np.array_equal(found, mv(A, x)):
            return False
    return True


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
) -> tuple[Record, Statuses] | None:
    """Simulate all runs of ``draws`` as `closed_loop.simulate` does, of a plant without bounds of its inputs.

    None where a law alters the measurements, or where some are missing that the filter bridges.
    """
    if draws.alterations:
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
    signals, status = _simulated(plant, compiled, filter_, law, limits, of_estimates, x0, w, v, n_steps, info)
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
    info: Collection[str],
) -> tuple[dict[str, Array], Statuses]:
    """Call the kernel; return x, y, x_hat, u and e (runs, samples, n), and the statuses."""
    from rmpc_bench.numerics import linear_loop_kernel as kernel

    schedule = filter_.schedule
    n_runs, nx, nu, ny, nh = len(x0), plant.nx, plant.nu, plant.ny, len(schedule.x0)
    form, law_rows, point = _packed_law(law, nh, nu)
    widths = {"x": (n_steps + 1, nx), "y": (n_steps + 1, ny), "x_hat": (n_steps + 1, nh), "u": (n_steps, nu)}
    signals = {name: np.empty((n_runs, *shape)) for name, shape in widths.items()}
    signals["e"] = np.empty((n_runs if "e" in info else 0, n_steps + 1, ny))
    corrects, driven = bool(schedule.L.any()), bool(schedule.B.any())
    shape = np.array([n_steps, nx, nu, ny, nh, form, corrects, driven, "e" in info, w.shape[2]])
    start = np.zeros(nu) if law.start is None else law.start
    low = np.full(nx, -np.inf) if limits.low is None else limits.low
    high = np.full(nx, np.inf) if limits.high is None else limits.high
    constants = np.concatenate([schedule.x0, start, [law.low, law.high], *point, low, high])
    with np.errstate(over="ignore", invalid="ignore"):
        status = limits.of_state(np.full(n_runs, OK), np.full(n_runs, OK), x0)
    status = np.array(status, dtype=np.int8)
    kernel.ready(kernel.loop_kernel, kernel.LOOP)(
        compiled.advance, compiled.measure, as_compiled(compiled.own), as_compiled(compiled.shared), compiled.sizes,
        np.zeros(compiled.work), as_compiled_statuses(compiled.status),
        as_compiled(_packed_filter(filter_)), as_compiled(law_rows), as_compiled(law.given), constants, shape,
        as_compiled(limits.of_x), as_compiled(np.broadcast_to(of_estimates, (n_runs, nh))),
        as_compiled(x0), as_compiled(w), as_compiled(v), *(signals[name] for name in ("x", "y", "x_hat", "u", "e")),
        status,
    )  # fmt: skip
    return signals, status


def as_compiled_statuses(status: Statuses) -> Statuses:
    """Return statuses of the one kind that the kernel is compiled for."""
    return np.require(status, np.int8, ["C", "W"])


def _packed_filter(filter_: CompiledFilter) -> Float[Array, "k packed"]:
    """Return the matrices of a filter side by side, row by row; missing constant parts are zero."""
    s = filter_.schedule
    ny, nh = s.C.shape[1:]
    d = np.zeros((1, ny)) if s.d is None else s.d
    f = np.zeros((1, nh)) if s.f is None else s.f
    return _side_by_side((s.C, d, s.L, s.F, s.B, s.K, f))


def _packed_law(law: CompiledLaw, nh: int, nu: int) -> tuple[int, Float[Array, "k packed"], tuple[Array, Array]]:
    """Return the form of a law, its matrices side by side, and its operating point, zero without one."""
    from rmpc_bench.numerics.linear_loop_kernel import AROUND_POINT, GIVEN, INCREMENT, REGULATOR

    point = (np.zeros(nh), np.zeros(nu)) if law.point is None else (law.point.x, law.point.u)
    K_x = np.zeros((1, nu, nh)) if law.K_x is None else law.K_x
    K_u = np.zeros((nu, nu)) if law.K_u is None else law.K_u
    u_0 = np.zeros((1, nu)) if law.u_0 is None else law.u_0
    if law.K_x is None:
        form = GIVEN
    elif law.K_u is not None:
        form = INCREMENT
    else:
        form = REGULATOR if law.point is None else AROUND_POINT
    return form, _side_by_side((K_x, K_u[None], u_0)), point


def _side_by_side(schedules: tuple[Array, ...]) -> Float[Array, "k packed"]:
    """Flatten the matrices of every k and put them side by side; one row if all are constant."""
    n = max(map(len, schedules))
    # A schedule may be longer than the experiment, and a law shorter than its filter.
    n = min(len(each) for each in schedules if len(each) > 1) if n > 1 else 1
    cut = [each[:n] if len(each) > 1 else each for each in schedules]
    return np.concatenate([np.broadcast_to(each, (n, *each.shape[1:])).reshape(n, -1) for each in cut], axis=1)


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
