"""Limits of a predictive controller: of the input and its increment, and soft ones of any signal of the design model.

Names   A soft limit names a signal z = Z x + z_0 of the design model: one of its own signals (`extra_signals`, such as
        `shaft_torque`), a state or an output by its place (`x.0`, `y.1`) or by its name, where the plant has names.
        With `of` it gives the rows Z itself, and the name is free.
Shared  By the controllers mpc, gpc and tube-mpc.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.intervals import Pairs, interval_of
from rmpc_bench.types import Array, Count, DesignError, Model, NonNegative, PlantInfo, Positive
from rmpc_bench.types.errors import no_such_component, unknown

Fallback = Literal["clip", "hold", "stop"]


@dataclass(frozen=True)
class Limits:
    """Bounds of the input and of its increment.

    Parameters
    ----------
    u : [low, high] for every input, or one pair per input; null where there is no bound
    du : [low, high] of u(k) - u(k-1), or one pair per input; without 0 inside, the program becomes infeasible at the
        limits of u
    enforce : `clip` clips the unconstrained minimiser, first its increment, then the input; `qp` solves a quadratic
        program
    fallback : where the quadratic program has no solution or is not solved, `clip` (default) applies the clipped
        unconstrained minimiser, `hold` u(k-1), and `stop` ends the run
    """

    u: Pairs | None = None
    du: Pairs | None = None
    enforce: Literal["clip", "qp"] = "clip"
    fallback: Fallback | None = None


@dataclass(frozen=True)
class SoftLimit:
    """A limit of a predicted signal that may be exceeded by a slack, at a cost.

    Parameters
    ----------
    limits : [low, high] of the signal, or one pair per row of it; null where there is no bound
    linear : cost of a slack of one `scale`; above the largest multiplier of the hard limit the limit is kept wherever
        that is possible
    scale : unit of the slack (default: high - low)
    quadratic : cost of half the square of a slack of one `scale`
    steps : samples k+1 to k+steps are limited (default: the horizon)
    of : row or rows Z of a signal z = Z x, where the design model does not name it; Z has no columns for disturbances
    """

    limits: Pairs
    linear: NonNegative
    scale: Positive | None = None
    quadratic: Positive = 1e-3
    steps: Count | None = None
    of: list[float] | list[list[float]] | None = None


class Bounds(NamedTuple):
    """Lower and upper bounds, one per input or row."""

    low: Float[Array, " n"]
    high: Float[Array, " n"]


class Signal(NamedTuple):
    """A signal z = Z x + constant of the design model, in physical units."""

    Z: Float[Array, "nz nx"]
    constant: Float[Array, " nz"]


class SoftRows(NamedTuple):
    """A soft limit of a signal, ready for a quadratic program."""

    signal: Signal
    bounds: Bounds
    scale: Float[Array, " nz"]
    linear: float
    quadratic: float
    steps: int


def bounds_of(pairs: Pairs | None, n: int, key: str) -> Bounds:
    """Return bounds of n signals, the lower ones below the upper ones; infinite without pairs."""
    return Bounds(*interval_of(pairs, n, key, distinct=True))


def refuse_unused(limits: Limits, soft: Mapping[str, SoftLimit] | None) -> None:
    """Refuse keys that have no effect without a quadratic program, and limits without a bound."""
    if soft and limits.enforce != "qp":
        raise DesignError("needs `limits: {enforce: qp}`: clipping limits inputs only", "soft")
    if limits.fallback is not None and limits.enforce != "qp":
        raise DesignError("has no effect with `enforce: clip`, which solves no program", "limits.fallback")
    if limits.u is None and limits.du is None and not soft:
        raise DesignError("has no limit to enforce: give u, du or `soft`", "limits")


def one_for_all(u: Bounds) -> tuple[float, float] | Bounds:
    """Return numbers where the bounds are the same for all inputs."""
    (low, high), same = u, all((each == each[0]).all() for each in u)
    return (float(low[0]), float(high[0])) if same else u


def require_effect(B: Float[Array, "nx nu"]) -> None:
    """Raise a DesignError if no input acts on the design model."""
    if not B.any():
        raise DesignError("B of the design model is zero, so that no input has an effect; give the model its B")


def without_effect(K_r: Float[Array, "nu rows"], horizon: int, key: str) -> tuple[str, ...]:
    """Return a remark on inputs that do not depend on the outputs of the horizon."""
    idle = ", ".join(map(str, np.flatnonzero(~K_r.any(axis=1))))
    text = f"the input has no effect within {key} = {horizon} on an output with weight (input {idle}): choose a longer"
    return (f"{text} {key}",) if idle else ()


def key_of(section: str, name: str) -> str:
    """Return the key of a signal, for messages: a name with a dot is quoted."""
    return f'{section}."{name}"' if "." in name else f"{section}.{name}"


def signal_of(name: str, model: Model, plant_info: PlantInfo | None = None, unnamed: int = 0) -> Signal:
    """Return the rows of a signal that the design model names.

    The name is one of `model.extra_signals`, a place such as ``x.0`` or ``y.1``, or that of a state or an output;
    the last `unnamed` states, such as disturbances, have none.  A DesignError gives the nearest known name.
    """
    if name in model.extra_signals:
        Z = np.array(model.extra_signals[name], dtype=float)
        return Signal(Z, np.zeros(len(Z)))
    named = _places(model, plant_info, unnamed)
    letter, _, number = named.get(name, name).partition(".")
    n = {"x": model.nx - unnamed, "y": model.ny}.get(letter)
    if n is None or not number.isdecimal():
        places = [f"x.{i}" for i in range(model.nx - unnamed)] + [f"y.{i}" for i in range(model.ny)]
        known = [*model.extra_signals, *named, *places]
        raise DesignError(unknown(name, known, "signal of the design model", "or give its rows with `of`"))
    i = int(number)
    if i >= n:
        raise DesignError(no_such_component({"x": "state", "y": "output"}[letter], i, n))
    if letter == "y":
        model.refuse_feedthrough("a limit of an output")
    Z, constant = (np.eye(n, model.nx), np.zeros(n)) if letter == "x" else (model.C, model.d0)
    return Signal(np.array(Z[i : i + 1]), np.array(constant[i : i + 1]))


def soft_rows(
    soft: Mapping[str, SoftLimit],
    model: LinearModel,
    horizon: int,
    plant_info: PlantInfo | None = None,
    unnamed: int | None = None,
) -> dict[str, SoftRows]:
    """Return the soft limits with the rows of their signals; the model's disturbances are unnamed if not given."""
    unnamed = model.n_disturbances if unnamed is None else unnamed
    found = {}
    for name, limit in soft.items():
        key = key_of("soft", name)
        try:
            if limit.of is None:
                signal = signal_of(name, model, plant_info, unnamed)
            else:
                signal = _own(limit.of, model.nx - unnamed, unnamed, key)
        except DesignError as error:
            raise DesignError(str(error), error.parameter or key) from None
        bounds = bounds_of(limit.limits, len(signal.Z), f"{key}.limits")
        if limit.steps is not None and limit.steps > horizon:
            raise DesignError(f"must be at most the horizon {horizon} (got {limit.steps})", f"{key}.steps")
        if limit.scale is None and not np.isfinite([*bounds.low, *bounds.high]).all():
            raise DesignError("has no `scale`, which has no default where a bound is infinite", key)
        scale = bounds.high - bounds.low if limit.scale is None else np.full(len(signal.Z), limit.scale)
        found[name] = SoftRows(signal, bounds, scale, limit.linear, limit.quadratic, limit.steps or horizon)
    return found


def _own(of: list[float] | list[list[float]], nx: int, unnamed: int, key: str) -> Signal:
    """Return the signal of given rows, which have no numbers for the states without names."""
    rows: list[Any] = [each for each in of if isinstance(each, list)] or [of]
    for row in rows:
        if len(row) != nx:
            raise DesignError(f"a row has {len(row)} numbers, and the design model has {nx} states", f"{key}.of")
    return Signal(np.pad(np.array(rows, dtype=float), ((0, 0), (0, unnamed))), np.zeros(len(rows)))


def _places(model: Model, plant_info: PlantInfo | None, unnamed: int) -> dict[str, str]:
    """Return the names of states and outputs that are no places -> their places."""
    if plant_info is None or (plant_info.nx, plant_info.ny) != (model.nx - unnamed, model.ny):
        return {}
    names = [(name, f"x.{i}") for i, name in enumerate(plant_info.states)]
    # A state and an output with one name: the output is the measured state, and the state is meant.
    names = [(name, f"y.{i}") for i, name in enumerate(plant_info.outputs)] + names
    return {name: place for name, place in names if name != place}


AntiWindup: TypeAlias = Literal["back-calculation", "clamping", "none"]


@dataclass(frozen=True)
class InputLimits:
    """Bounds of the input.

    Parameters
    ----------
    u : [low, high] for every input, or one pair per input, in the unit of the input
    """

    u: Pairs


def common_limits(bounds: Bounds) -> tuple[float, float] | Bounds | None:
    """Return the lower and the upper limit of all inputs, or of each; None where there are none."""
    return None if np.isinf(bounds).all() else one_for_all(bounds)
