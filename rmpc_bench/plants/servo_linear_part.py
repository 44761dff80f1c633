"""Linear part of the servomechanism (no dry friction): for the model mismatch, and between the samples.

Also the valid ranges of its parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.models.servo import MUST_BE_POSITIVE
from rmpc_bench.numerics.linalg import discretise, mv
from rmpc_bench.types import Array, LinearPlant


def admissible(parameters: Mapping[str, Float[Array, " runs"]]) -> Bool[Array, " runs"]:
    """Whether the parameters of each run are valid: divisors are positive, no parameter is negative.

    Parameters
    ----------
    parameters : name -> value of every run
    """
    good = np.ones(len(next(iter(parameters.values()))), dtype=bool)
    for name, values in parameters.items():
        positive = name in (*MUST_BE_POSITIVE, "L")
        good &= np.isfinite(values) & ((values > 0.0) if positive else (values >= 0.0))
    return good


def linear_part(
    continuous: Callable[[Mapping[str, float]], tuple[Array, Array]], parameters: Mapping[str, float], Ts: float
) -> LinearPlant | None:
    """Sample the linear part with a zero-order hold of the voltage.

    The first four states are those of the model; the fifth, the armature current, is not part of it.

    Parameters
    ----------
    continuous : parameters -> continuous-time matrices; the voltage is the first input
    parameters : parameters of one run
    Ts : sampling time [s]

    Returns
    -------
    LinearPlant or None
        None if a parameter is out of range.
    """
    if not admissible({name: np.array([value]) for name, value in parameters.items()})[0]:
        return None
    A, B = discretise(*continuous(parameters), Ts)
    return LinearPlant(A, B[:, :1], np.eye(1, len(A)), np.eye(4, len(A)))


def linear_between(
    E: Float[Array, "runs nx nx"],
    G: Float[Array, "runs nx nu"],
    x: Float[Array, "runs steps nx"],
    u: Float[Array, "runs steps nu"],
    parts: int,
) -> Float[Array, "runs steps parts nx"]:
    """Return the states at the ends of equal parts of every control period.

    Parameters
    ----------
    E, G : dynamics of every run, sampled over one part of a period
    x, u : states at the beginning of the periods, and inputs
    parts : number of parts per period
    """
    states = np.empty((*x.shape[:2], parts, x.shape[2]))
    for k in range(x.shape[1]):
        now, driven = x[:, k], mv(G, u[:, k])
        for part in range(parts):
            now = mv(E, now) + driven
            states[:, k, part] = now
    return states
