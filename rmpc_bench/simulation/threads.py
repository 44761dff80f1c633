"""Number of threads of the linear algebra library (BLAS)."""

from __future__ import annotations

from contextlib import AbstractContextManager


def single_thread() -> AbstractContextManager[object]:
    """Limit BLAS to one thread, for good or inside a ``with``.

    Several threads change the last bits of a result and are slower on small matrices.
    """
    # SciPy loads a BLAS of its own, and only a loaded library can be limited.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    return threadpool_limits(limits=1)  # type: ignore[no-any-return]
