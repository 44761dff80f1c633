"""What identifies a component that a program, a notebook or an installed package has registered."""

import sys
import types

import numpy as np
import pytest

from rmpc_bench import registry
from rmpc_bench.components.object_source import _Walk, object_hash, registered_identity
from rmpc_bench.components.source import Source

CELL = '''
import math

GAIN = {gain}
TABLE = np.array([1.0, {entry}])


def scaled(x):
    return {factor} * x


class Filter:
    """{doc}"""

    limits = (0.0, {limit})

    def update(self, y):
        # {comment}
        return GAIN * scaled(math.sqrt(abs(y))) + TABLE[1] if y in {{1, 2, "a"}} else self.inner(y)

    def inner(self, y):
        return [entry for entry in (y, {constant})]


unused = {unused}
'''
VALUES = {"gain": 0.5, "entry": 2.0, "factor": 3, "doc": "A filter.", "limit": 1.0, "comment": "c", "constant": 4}


@pytest.fixture
def cell(monkeypatch):
    """Return a function that executes the cell of a notebook with some values and returns its class."""

    def execute(**changed):
        module = types.ModuleType("notebook")
        module.np = np
        monkeypatch.setitem(sys.modules, "notebook", module)
        exec(CELL.format(**{**VALUES, "unused": 1, **changed}), vars(module))
        return module.Filter

    return execute


def test_the_same_cell_has_the_same_hash(cell):
    """Executed again; a comment, a docstring and what the class does not use change nothing."""
    first = object_hash(cell())
    assert first == object_hash(cell())
    for changed in ({"comment": "another\n"}, {"doc": "The filter."}, {"unused": 2}):
        assert object_hash(cell(**changed)) == first


@pytest.mark.parametrize("name", ["gain", "entry", "factor", "limit", "constant"])
def test_all_that_a_class_uses_counts(cell, name):
    """Its own code, functions and values of the notebook that it names, and arrays."""
    assert object_hash(cell()) != object_hash(cell(**{name: 7}))


def test_equal_entries_of_a_list_count_each():
    """The objects of small numbers are the same."""

    def made(*values):
        return lambda: values

    assert object_hash(made(1, 2, 1)) != object_hash(made(1, 2, 2))


def test_a_registered_module_on_the_path_counts_by_its_source(tmp_path, monkeypatch):
    """As of an editable installation; the version does not change with an edit."""
    (tmp_path / "lab_filters.py").write_text("def design(model):\n    return 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    import lab_filters

    monkeypatch.setitem(registry._REGISTERED["estimators"], "lab", lab_filters.design)
    before = registered_identity("estimators", "lab")
    assert isinstance(before, Source) and before.path == tmp_path / "lab_filters.py"
    (tmp_path / "lab_filters.py").write_text("def design(model):\n    return 2\n")
    assert registered_identity("estimators", "lab").sha != before.sha
    del sys.modules["lab_filters"]


def test_an_installed_component_counts_by_package_and_version(monkeypatch):
    """An update computes its methods again."""

    class Point:
        module = "filterpy.kalman"

    class Installed:
        points = (Point,)
        origin = "my-package 1.2"

    monkeypatch.setattr(registry, "installed_component", lambda group, name: Installed)
    assert registered_identity("estimators", "my-filter") == "my-package 1.2"


def test_an_object_in_the_place_of_a_freed_one_counts():
    """Lists that exist only while the hash is made may have the same identity, one after the other."""
    walk = _Walk("notebook")
    assert all([*walk.texts([value])] == [b"list", repr(value).encode()] for value in (1.0, 2.0, 3.0))
