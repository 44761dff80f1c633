"""Number of threads of the linear algebra library (BLAS)."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any


def single_thread() -> AbstractContextManager[object]:
    """Limit BLAS to one thread, for good or inside a ``with``.

    Several threads change the last bits of a result and are slower on small matrices.
    """
    # SciPy loads a BLAS of its own, and only a loaded library can be limited.
    import scipy.linalg  # noqa: F401

    return _libraries(len(sys.modules)).limit(limits=1)  # type: ignore[no-any-return]


@lru_cache(maxsize=1)
def _libraries(n_modules: int) -> Any:
    """Find the loaded libraries (0.8 ms), anew after an import only: one that `ctypes` loads later is not found."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
