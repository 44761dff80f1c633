"""Blocks of runs as the functions of a differential equation take them: axis 0 is the state and axis 1 the run."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, Parameters

WIDTH = 8
"""A block is filled up to a multiple of this many runs.  Sums and products of matrices take another path for a single
run, with other last bits than within a block."""


def padded(each: Float[Array, "runs n"]) -> Float[Array, "n width"]:
    """Return runs as columns, and the last one again until there is a multiple of `WIDTH`."""
    return np.ascontiguousarray(np.pad(each, ((0, -len(each) % WIDTH), (0, 0)), mode="edge").T)


def rows(names: Mapping[str, float], columns: Float[Array, "n_parameters width"]) -> Parameters:
    """Parameters by name, a row over the runs each, which a user's function cannot write into."""
    columns.flags.writeable = False
    return Parameters(dict(zip(names, columns, strict=True)))
