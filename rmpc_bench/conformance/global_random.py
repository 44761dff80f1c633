"""The global random generators, on which a component must not depend."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

SEED = 16
"""Of the random generators that components get."""


@contextmanager
def global_seed(seed: int) -> Iterator[None]:
    """Seed the global random generators of Python and NumPy, and restore them at the end.

    Parameters
    ----------
    seed : of both generators
    """
    numpy_state, python_state = np.random.get_state(), random.getstate()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002  # the generator that a component must not use
    random.seed(seed)
    try:
        yield
    finally:
        np.random.set_state(numpy_state)  # noqa: NPY002
        random.setstate(python_state)
