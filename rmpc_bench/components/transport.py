"""Experiments as bytes for worker processes.

A design from a file of the user, or registered by a program or a package, is sent as its recipe (the call that
made it) and made again in the worker.  A design need not be picklable.  The texts of the user's files are sent as well,
so that every worker runs the same code, also after a file has changed.  Functions and classes of a notebook or a
script, which no worker can import, are sent by value.
"""

from __future__ import annotations

import io
import pickle
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from rmpc_bench.components.private_modules import Package, add, is_private, packages
from rmpc_bench.components.recipes import Recipe, recipe_of
from rmpc_bench.components.source import read_source


def dumps(experiments: Any) -> bytes:
    """Pickle experiments for a worker process on this machine."""
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
                return _made, (recipe if recipe.code is None else recipe.without_design(),)
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
    """Whether a worker process, which has the same path of Python and the same import hooks, can import a module.

    A package that is installed as editable is found by a hook and not on the path.
    """
    top = name.partition(".")[0]
    found = (finder.find_spec(top, None) for finder in sys.meta_path if hasattr(finder, "find_spec"))
    return top in sys.builtin_module_names or any(spec is not None for spec in found)
