"""Compilation of kernels by numba, with a cache of the compiled code where a directory for it is writable.

A file of kernels is imported at the first step only, as numba takes long to load.  Kernels that call one another are in
one file, because the cache does not detect a change of a function in another file.

numba tries NUMBA_CACHE_DIR, then the directory of the module, then the cache directory of the user.  If none of them is
writable, as in a read-only installation with a read-only home, the kernels are compiled in every process.

numba is imported here only.  It would read .numba_config.yaml in the current directory, which may come from somebody
else and name a directory of compiled code.  Variables such as NUMBA_CACHE_DIR, which the user sets, have their effect.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import chdir
from functools import partial
from importlib import import_module
from typing import Any, TypeVar, cast

from rmpc_bench.extras import stand_ins
from rmpc_bench.numerics.code_cache import WITHOUT_FILE

if "numba" not in sys.modules:
    # It imports `coverage` (0.05 s) for NUMBA_JIT_COVERAGE only; who wants that imports coverage first.
    with chdir(sys.prefix), stand_ins({"coverage": None}):
        import_module("numba").core.config._config_fname = ""
numba: Any = import_module("numba")

F = TypeVar("F", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[F], F]:
    """Return a decorator that compiles a kernel at its first call, with options of ``numba.njit``."""

    def decorate(function: F) -> F:
        kernel: Any
        try:
            kernel = numba.njit(cache=True, **options)(function)
        except RuntimeError:
            # No directory for the cache is writable.
            WITHOUT_FILE.append(function.__name__)
            kernel = numba.njit(**options)(function)
        # Without a cache, or where numba does not compile (NUMBA_DISABLE_JIT), nothing is saved.
        cache = getattr(kernel, "_cache", None)
        if cache is not None:
            cache.save_overload = partial(_save, cache.save_overload, function.__name__)
            if hasattr(cache, "_load_overload"):
                cache.load_overload = partial(_load, cache)
        return cast(F, kernel)

    return decorate


def _load(cache: Any, signature: Any, context: Any) -> Any:
    """Load compiled code without all that numba can compile (0.15 s), which it loads anyway before it compiles."""
    numba.core.runtime.rtsys.initialize(context)
    with cache._guard_against_spurious_io_errors():
        return cache._load_overload(signature, context)


def _save(save: Callable[..., None], name: str, *arguments: Any) -> None:
    """Save compiled code; a disk that is full now does not end a computation that does not need the file."""
    try:
        save(*arguments)
    except OSError:
        WITHOUT_FILE.append(name)
