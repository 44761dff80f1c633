"""What code of a user replaces in NumPy, SciPy, pandas, Python or the bench is put back, since every component uses it.

This costs some milliseconds per file, design or block, and cannot see what compiled code changes.  Methods with other
files are therefore also computed in processes of their own, see `rmpc_bench.execution.separation`.
"""

from __future__ import annotations

import builtins
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rmpc_bench.registry import BUILT_IN

_ROOTS = frozenset({"numpy", "scipy", "pandas", "rmpc_bench", "builtins", "math", "cmath", "random", "json"})
_VARIABLES = ("NUMBA_", "NPY_", "OMP_", "OPENBLAS_", "MKL_", "BLIS_", "VECLIB_", "NUMEXPR_", "PYTHON")
"""Starts of the names of environment variables that change the numbers of processes that are started later."""
replaced: dict[str, set[str]] = {}
"""Python file of a user -> names of what its import and its designs have replaced in this process."""


@contextmanager
def untouched(file: str = "") -> Iterator[set[str]]:
    """Put back what the code of a file replaces; the set gets the names of functions, classes and constants.

    The error state and the printed form of numbers and the variables of the environment are put back without a word:
    files of users often set them for themselves.
    """
    import numpy as np

    found = set[str]()
    holders = [(name, holder, dict(vars(holder))) for name, holder in _holders()]
    kinds = {group: dict(known) for group, known in BUILT_IN.items()}
    variables, state, printing = _variables(), np.geterr(), np.get_printoptions()
    try:
        yield found
    finally:
        for name, holder, before in holders:
            now = vars(holder)
            for key in [key for key, value in before.items() if now.get(key) is not value]:
                if _is_common(key, before[key]):
                    setattr(holder, key, before[key])
                    found.add(f"{name}.{key}")
            # A new name may hide an inherited method, or a function of Python.
            hidden = object if isinstance(holder, type) else builtins
            for key in [key for key, value in now.items() if key not in before and _is_common(key, value)]:
                if hidden is object and not key.startswith("__") or hasattr(hidden, key):
                    delattr(holder, key)
                    found.add(f"{name}.{key}")
        for group, known in kinds.items():
            found |= {f"the kind {key} of {group}" for key in known if BUILT_IN[group].get(key) != known[key]}
            BUILT_IN[group].update(known)
        for variable in {*variables, *_variables()}:
            os.environ.pop(variable, None)
        os.environ.update(variables)
        np.seterr(**state)
        np.set_printoptions(**printing)
        if found and file:
            replaced[file] = replaced.get(file, set()) | found


def _holders() -> Iterator[tuple[str, Any]]:
    """Yield the modules that every component uses, and the classes of the bench, each with its name."""
    for name, module in [*sys.modules.items()]:
        if name.partition(".")[0] in _ROOTS and module is not None:
            yield name, module
            if name.startswith("rmpc_bench."):
                for value in [*vars(module).values()]:
                    if isinstance(value, type) and value.__module__ == name:
                        yield f"{name}.{value.__qualname__}", value


def _is_common(key: str, before: Any) -> bool:
    """Whether others use an entry of a module; its caches and counters may change."""
    constant = isinstance(before, bool | int | float | complex | str | tuple) and key.isupper()
    return (
        constant
        or isinstance(before, (float, property, classmethod, staticmethod))
        or (callable(before) and not key.startswith("__abc"))
    )


def _variables() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name.startswith(_VARIABLES)}
