"""The identity of a component that a program, a notebook or an installed package has registered."""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from rmpc_bench import registry
from rmpc_bench.components.imports import Import
from rmpc_bench.components.reference import is_standard, local_directory, module_files
from rmpc_bench.components.source import Source, read_source


def registered_identity(group: str, kind: str) -> Source | str:
    """Return the source of a registered component's module, ``name version`` of its package, or a hash (notebook)."""
    installed = registry.installed_component(group, kind)
    found = None if installed is not None else inspect.unwrap(registry.get(group, kind))
    file = _file(found.__module__ if installed is None else installed.points[0].module)
    if file is not None:
        return read_source(file)
    if installed is not None:
        return installed.origin
    return object_hash(registry.get(group, kind))


def _file(module: str) -> Path | None:
    """Return the file of a module that may change while its version does not; it is not imported for that."""
    name = module.partition(".")[0]
    directory = local_directory(name)
    if directory is not None:
        return next(reversed(module_files(directory, Import(module, (), 0))), None)
    loaded = sys.modules.get(module)
    file = getattr(loaded, "__file__", None)
    # A program (`__main__`), or a module that was loaded by its path.
    is_program = not is_standard(name) and getattr(loaded, "__spec__", None) is None
    return Path(file) if is_program and file is not None and Path(file).is_file() else None


def object_hash(found: Any) -> str:
    """Return a hash of a function or class that stands in no file, and of all that it uses of its module.

    Comments and layout do not count.  Another version of Python gives another hash.
    """
    hasher = hashlib.sha256(sys.version.encode())
    for text in _Walk(inspect.unwrap(found).__module__).texts(found):
        hasher.update(text + b"\n")
    return hasher.hexdigest()


class _Walk:
    """Finds what determines the behaviour of an object; what other modules have counts by its name."""

    def __init__(self, module: str) -> None:
        self.module = module
        # The objects are kept: the identity of one that has been freed may be that of another.
        self._seen: dict[int, Any] = {}

    def texts(self, found: Any) -> Iterator[bytes]:
        """Yield the parts of an object, those of what it uses included."""
        if isinstance(found, int | float | complex | str | bytes | None):
            yield repr(found).encode()
        elif isinstance(found, np.ndarray):
            yield repr((found.dtype, found.shape)).encode() + found.tobytes()
        elif id(found) not in self._seen:
            self._seen[id(found)] = found
            yield type(found).__name__.encode()
            yield from self._parts(found)

    def _parts(self, found: Any) -> Iterator[bytes]:
        if isinstance(found, list | tuple):
            for each in found:
                yield from self.texts(each)
        elif isinstance(found, dict):
            for name, value in found.items():
                yield repr(name).encode()
                yield from self.texts(value)
        elif isinstance(found, staticmethod | classmethod):
            yield from self.texts(found.__func__)
        elif isinstance(found, property):
            yield from self.texts((found.fget, found.fset))
        elif isinstance(found, ModuleType):
            yield found.__name__.encode()
        elif getattr(found, "__module__", None) != self.module:
            yield f"{getattr(found, '__module__', '')}.{getattr(found, '__qualname__', '')}".encode()
        elif isinstance(found, FunctionType):
            yield from self._function(found)
        elif inspect.isclass(found):
            yield from self.texts(found.__bases__)
            own = {name: value for name, value in vars(found).items() if name not in _NO_MEANING}
            yield from self.texts(own)

    def _function(self, found: FunctionType) -> Iterator[bytes]:
        yield from _code(found.__code__)
        closed = [cell.cell_contents for cell in found.__closure__ or ()]
        used = {name: found.__globals__[name] for name in sorted(_names(found.__code__)) if name in found.__globals__}
        for each in (closed, used, found.__defaults__, found.__kwdefaults__, getattr(found, "__wrapped__", None)):
            yield from self.texts(each)


_NO_MEANING = ("__doc__", "__module__", "__dict__", "__weakref__", "__firstlineno__", "__static_attributes__")
"""Attributes of a class that its code does not determine, or that determine nothing."""


def _code(code: CodeType) -> Iterator[bytes]:
    yield code.co_code
    yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_flags)).encode()
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _code(constant)
        else:
            # The order of a set differs from process to process.
            text = sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant
            yield repr(text).encode()


def _names(code: CodeType) -> set[str]:
    """Names that code may look up in its module, those of inner functions included."""
    inner = (_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)
