"""Experiments as bytes for worker processes, where a design is the call that makes it again."""

from __future__ import annotations

import atexit
import dataclasses
import glob
import io
import os
import pickle
import platform
import shutil
import sys
import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from tempfile import gettempdir, mkdtemp
from typing import Any

from rmpc_bench.components.designs import loaded_design
from rmpc_bench.components.loading import Package, add, is_private, load, packages
from rmpc_bench.components.reference import CodeReference, DataReference, spec_of
from rmpc_bench.components.source import read_source
from rmpc_bench.components.user_code import untouched


def process_directory(name: str) -> Path:
    """Make a temporary directory that is removed at the end of this process, or later by another one.

    A worker process may be ended at any time, without its exit handlers.  The name therefore contains machine and
    process; every process removes the directories of processes that have ended.
    """
    prefix = f"{name}-{platform.node()}-"
    _remove(prefix, ended_only=True)
    made = Path(mkdtemp(prefix=f"{prefix}{os.getpid()}-"))
    atexit.register(partial(_remove, prefix, ended_only=False))
    return made


def _remove(prefix: str, *, ended_only: bool) -> None:
    """Remove the directories of processes that have ended, and those of this process."""
    for directory in Path(gettempdir()).glob(f"{glob.escape(prefix)}*"):
        process = directory.name.removeprefix(prefix).partition("-")[0]
        own = process == str(os.getpid())
        if (own and not ended_only) or (not own and process.isdigit() and _has_ended(int(process))):
            shutil.rmtree(directory, ignore_errors=True)


def _has_ended(process: int) -> bool:
    if os.name != "posix":
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False


@dataclass(frozen=True, eq=False)
class Recipe:
    """The call that makes a design."""

    group: str
    design: Callable[..., Any] | None  # the design function; not used for a component from a file
    code: CodeReference | None  # where a component from a file stands; None for others
    provided: Mapping[str, Any]  # what the bench gives to the design function
    parameters: Mapping[str, Any]  # its other keywords, with references in place of what stands in files of the user

    def make(self) -> Any:
        """Call the design function."""
        design = self.design if self.code is None else loaded_design(self.group, self.code)
        assert design is not None
        files = [*self._files()]
        if not files and str(getattr(design, "__module__", "")).startswith("rmpc_bench."):
            return design(**self.provided, **loaded(self.parameters))
        with untouched(files[0] if files else ""):
            return design(**self.provided, **loaded(self.parameters))

    def _files(self) -> Iterator[str]:
        """Yield the Python files whose code the call may run."""
        yield from (str(each.path) for each in inside([self.code, self.parameters]) if isinstance(each, CodeReference))
        for recipe in map(recipe_of, self.provided.values()):
            if recipe is not None:
                yield from recipe._files()

    def remember(self, made: Any) -> None:
        """Note that a design was made in this way."""
        number = id(made)
        try:
            # The identity of an object may be used again after its end.
            kept: Any = weakref.ref(made, lambda _: _recipes.pop(number, None))
        except TypeError:
            kept = made
        _recipes[number] = kept, self


_recipes: dict[int, tuple[Any, Recipe]] = {}
"""Identity of a design -> a reference to it, and how it was made."""


def recipe_of(made: Any) -> Recipe | None:
    """Return how an object was made; None for anything but a remembered design."""
    entry = _recipes.get(id(made))
    return None if entry is None else entry[1]


def loaded(value: Any) -> Any:
    """Return a validated value with objects in place of references, and paths in place of data files."""
    if isinstance(value, CodeReference):
        return load(value)
    if isinstance(value, DataReference):
        return value.paths
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        return type(value)(loaded(each) for each in value)
    if isinstance(value, Mapping):
        return {key: loaded(each) for key, each in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and any(inside(value)):
        return dataclasses.replace(
            value, **{field.name: loaded(getattr(value, field.name)) for field in dataclasses.fields(value)}
        )
    return value


def inside(value: Any) -> Iterator[CodeReference | DataReference]:
    """Yield the references to files inside a validated value."""
    if isinstance(value, CodeReference | DataReference):
        yield value
    elif isinstance(value, list | tuple):
        for each in value:
            yield from inside(each)
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from inside(each)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield from inside(getattr(value, field.name))


def dumps(experiments: Any) -> bytes:
    """Pickle experiments for a worker process on this machine.

    A design from a file of the user, or registered by a program or a package, is sent as its recipe; it need not be
    picklable.  The texts of the files are sent as well, so that every worker runs the same code.  Functions and classes
    of a notebook or a script, which no worker can import, are sent by value.
    """
    stream = io.BytesIO()
    _pickler(stream).dump(experiments)
    for package in packages():
        _add_late_imports(package)
    return pickle.dumps((packages(), stream.getvalue()))


def loads(data: bytes) -> Any:
    """Make experiments again from the bytes of `dumps`."""
    sent, content = pickle.loads(data)
    for package in sent:
        add(Package(package.name, package.directory, package.sources, fixed=True))
    return pickle.loads(content)


def _add_late_imports(package: Package) -> None:
    """Add the texts of files that functions import when they are called; who has sent a package has done it."""
    if package.fixed or not package.is_current():
        return
    for file in [*package.sources]:
        for each in read_source(Path(file)).files:
            if each.path.suffix == ".py" and each.path.is_relative_to(package.directory):
                package.sources.setdefault(str(each.path), each.path.read_bytes())


def _made(recipe: Recipe) -> Any:
    """Make a design in a worker process; it may be sent on from there."""
    made = recipe.make()
    recipe.remember(made)
    return made


def _pickler(stream: io.BytesIO) -> Any:
    """Return a pickler for which a design with a recipe is its recipe."""
    cloudpickle = _cloudpickle()
    by_value: set[str] = set()

    def send_module(name: str | None) -> None:
        """Send what a module defines by value where a worker cannot import the module."""
        module = sys.modules.get(name or "__main__")
        if name is None or name in by_value or name == "__main__" or is_private(name) or module is None:
            return
        if not _is_importable(name):
            by_value.add(name)
            cloudpickle.register_pickle_by_value(module)

    class Pickler(cloudpickle.Pickler):  # type: ignore[misc,name-defined]
        def reducer_override(self, obj: Any) -> Any:
            recipe = recipe_of(obj)
            if recipe is not None:
                # The function of a component from a file is loaded by its reference.
                return _made, (recipe if recipe.code is None else dataclasses.replace(recipe, design=None),)
            send_module(getattr(obj, "__module__", None) if callable(obj) else None)
            return super().reducer_override(obj)

    return Pickler(stream)


def _cloudpickle() -> Any:
    """Import the pickler of joblib: a package of its own, or a part of joblib in versions before 1.6."""
    try:
        return import_module("cloudpickle")
    except ModuleNotFoundError:
        return import_module("joblib.externals.cloudpickle")


def _is_importable(name: str) -> bool:
    """Whether a worker process, which has the same path of Python and the same import hooks, can import a module."""
    # A package that is installed as editable is found by a hook and not on the path.
    top = name.partition(".")[0]
    return top in sys.builtin_module_names or spec_of(top) is not None
