"""NumPy's global random generator replaced by that of a run, for libraries that draw from the global one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


def drawing_from(rng: np.random.Generator, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function whose draws from NumPy's global generator come from another one.

    The state of the global generator stays as it is, apart from a normal number that it may have drawn in advance.

    Examples
    --------
    >>> drawing_from(np.random.default_rng(1), np.random.uniform)() == np.random.default_rng(1).uniform()
    True
    """

    def call(*arguments: Any, **keywords: Any) -> Any:
        before = np.random.get_bit_generator()  # type: ignore[attr-defined]  # noqa: NPY002
        np.random.set_bit_generator(rng.bit_generator)  # type: ignore[attr-defined]  # noqa: NPY002
        try:
            return function(*arguments, **keywords)
        finally:
            np.random.set_bit_generator(before)  # type: ignore[attr-defined]  # noqa: NPY002

    return call
