"""Parts of libraries that no command needs and that it does not load: a twelfth of the time of a short one.

A library that has changed, so that a name is gone or a part is needed, is loaded as usual.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import ModuleType


def load_scipy() -> None:
    """Load SciPy while empty modules stand for two of NumPy, which it would load only to copy their names."""
    import numpy

    names = vars(numpy)
    empty = {name: ModuleType(name) for name in ("f2py", "testing") if f"numpy.{name}" not in sys.modules}
    names |= empty
    try:
        with suppress(AttributeError, ImportError):
            import scipy.linalg  # noqa: F401
    finally:
        for name, module in empty.items():
            if names.get(name) is module:
                del names[name]  # NumPy loads the module itself when it is asked for


@contextmanager
def without_docstrings_of_artists() -> Iterator[None]:
    """Let matplotlib define its artists without signature and docstring of `set`, half of the time of its import."""
    from matplotlib.artist import Artist

    name = "_update_set_signature_and_docstring"
    usual = vars(Artist).get(name)
    setattr(Artist, name, classmethod(lambda cls: None))
    try:
        yield
    finally:
        setattr(Artist, name, usual) if usual is not None else delattr(Artist, name)
