"""Checks of the functions of a differential equation with plausible numbers, when the plant is designed.

The numbers lie around the initial state, within the bounds; inputs within their bounds, those without bounds are
standard normal.  The parameters lie within 10 % of the nominal ones.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.ode_blocks import padded, rows
from rmpc_bench.models.ode_names import function_name
from rmpc_bench.types import Array, DesignError, Ode, Parameters

ALONE, BLOCKS = 7, (7, 13, 50)
"""Runs that are compared alone, and sizes of the blocks that they are compared with."""
BENCH = __file__.removesuffix("plants/ode_checks.py")
"""Directory of the bench, whose frames are left out of messages."""
SPREAD = 0.3
"""Standard deviation of a state without bounds, relative to 0.1 plus its initial magnitude."""


class Sample(NamedTuple):
    """Plausible numbers of some runs."""

    x: Float[Array, "runs nx"]
    u: Float[Array, "runs nu"]
    numbers: Float[Array, "runs n_parameters"]

    def run(self, ode: Ode, i: int) -> tuple[Array, Array, Parameters]:
        """Return state, inputs and parameters of one run, as numbers."""
        return self.x[i], self.u[i], Parameters(dict(zip(ode.nominal, self.numbers[i].tolist(), strict=True)))


def sample(ode: Ode, x0: Float[Array, " nx"], n_runs: int) -> Sample:
    """Return plausible numbers; the first run is at x0 with nominal parameters."""
    rng = np.random.Generator(np.random.PCG64(7))
    low, high = ode.limits(ode.states)
    bounded = np.isfinite(low) & np.isfinite(high)
    x = x0 + SPREAD * (0.1 + np.abs(x0)) * rng.standard_normal((n_runs, ode.nx))
    x = np.clip(np.where(bounded, _within(rng.random((n_runs, ode.nx)), low, high), x), low, high)
    nominal = np.array(list(ode.nominal.values()))
    numbers = nominal * rng.uniform(0.9, 1.1, (n_runs, len(nominal)))
    x[0], numbers[0] = np.clip(x0, low, high), nominal
    return Sample(x, inputs(ode, rng, (n_runs,)), numbers)


def inputs(ode: Ode, rng: np.random.Generator, shape: tuple[int, ...]) -> Float[Array, "*shape nu"]:
    """Draw inputs: uniform between two bounds, else standard normal within the one there is."""
    low, high = ode.limits(ode.inputs)
    bounded = np.isfinite(low) & np.isfinite(high)
    shares, normal = rng.random((*shape, ode.nu)), rng.standard_normal((*shape, ode.nu))
    drawn: Array = np.clip(np.where(bounded, _within(shares, low, high), normal), low, high)
    return drawn


def _within(shares: Array, low: Array, high: Array) -> Array:
    with np.errstate(invalid="ignore"):
        return np.asarray(low + (high - low) * shares)


def rhs_takes_blocks(ode: Ode, x0: Float[Array, " nx"]) -> str:
    """Say why a right-hand side must be called run by run; empty where a block has the same bits as each run alone."""
    some = sample(ode, x0, max(BLOCKS))
    return _takes_blocks(
        lambda part, p: ode.slope(0.0, padded(part.x), padded(part.u), p),
        lambda x, u, p: ode.slope(0.0, x, u, p),
        ode, some, "ode", function_name(ode.rhs),
    )  # fmt: skip


def output_takes_blocks(ode: Ode, x0: Float[Array, " nx"], key: str = "output") -> str:
    """Say the same of an output function, which a key of the configuration names."""
    some = sample(ode, x0, max(BLOCKS))
    return _takes_blocks(
        lambda part, p: ode.measure(padded(part.x), p),
        lambda x, u, p: ode.measure(x, p),
        ode, some, key, function_name(ode.output),
    )  # fmt: skip


def _takes_blocks(
    block: Callable[[Sample, Parameters], Array],
    alone: Callable[[Array, Array, Parameters], Array],
    ode: Ode,
    some: Sample,
    key: str,
    name: str,
) -> str:
    """Compare blocks of runs with each run alone."""

    def values(part: slice) -> Array:
        chosen = Sample(*(each[part] for each in some))
        found: Array = block(chosen, rows(ode.nominal, padded(chosen.numbers)))[:, : len(chosen.x)]
        return found

    try:
        single = np.concatenate([values(slice(i, i + 1)) for i in range(ALONE)], axis=1)
        together = [values(slice(0, n)) for n in BLOCKS]
        shifted = values(slice(3, 3 + BLOCKS[1]))
    except Exception as error:
        _require_numbers(alone, ode, some, key, name)
        _require_repeatable(alone, ode, some, key, name)
        return f"a block of runs gives {describe_error(error)}"
    _require_repeatable(alone, ode, some, key, name)
    same = all(_equal(each[:, :ALONE], single) for each in together)
    if not same or not _equal(shifted, together[-1][:, 3 : 3 + BLOCKS[1]]):
        return "a run in a block has other bits than alone"
    if not np.isfinite(single[:, 0]).all():
        raise DesignError(_not_finite(name, ode, some, single[:, 0]), key)
    return ""


def _require_numbers(
    alone: Callable[[Array, Array, Parameters], Array], ode: Ode, some: Sample, key: str, name: str
) -> None:
    """Call a function of the user with the numbers of the first run."""
    x, u, p = some.run(ode, 0)
    try:
        found = alone(x, u, p)
    except Exception as error:
        raise DesignError(f"{name} fails at {_at(ode, x, u)}: {describe_error(error)}", key) from error
    if not np.isfinite(found).all():
        raise DesignError(_not_finite(name, ode, some, found), key)


def _require_repeatable(
    alone: Callable[[Array, Array, Parameters], Array], ode: Ode, some: Sample, key: str, name: str
) -> None:
    """Refuse a function of the user that gives other numbers for the same arguments."""
    try:
        first, second = (alone(*some.run(ode, 0)) for _ in range(2))
    except Exception:
        # A function that only takes blocks; the caller reports one that takes neither.
        return
    if not _equal(first, second):
        text = f"{name} returns other numbers for the same arguments, as with random numbers or a memory of its own; "
        raise DesignError(f"{text}use noise.process, or a plant that is a class marked @single_run", key)


def describe_error(error: Exception) -> str:
    """Return type, message and place of an exception of a user's function: ``ValueError: .. (tanks.py:12)``."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [each for each in frames if not each.filename.startswith(BENCH) and "site-packages" not in each.filename]
    place = f" ({own[-1].filename.rpartition('/')[2]}:{own[-1].lineno})" if own else ""
    return f"{type(error).__name__}: {error}{place}"


def _equal(found: Array, expected: Array) -> bool:
    return np.array_equal(found, expected, equal_nan=True)


def _at(ode: Ode, x: Array, u: Array) -> str:
    pairs = [*zip(ode.states, x, strict=True), *zip(ode.inputs, u, strict=True)]
    return ", ".join(f"{name} = {value:g}" for name, value in pairs)


def _not_finite(name: str, ode: Ode, some: Sample, found: Array) -> str:
    values = ", ".join(f"{value:g}" for value in found)
    way_out = "give another initial.x, or bounds"
    return f"{name} returns {values} at {_at(ode, some.x[0], some.u[0])}, which are not all finite; {way_out}"
