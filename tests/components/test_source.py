"""The identity of a Python file with the modules that it imports."""

import sys

import pytest

from rmpc_bench.components.reference import distribution_of, local_directory
from rmpc_bench.components.source import read_source

TANKS = """
import math
import numpy as np
import filterpy
from pi import K

class MHE:
    depends_on = ["table.npz"]

    def update(self, y):
        from lib.inner import gain
        return gain * y
"""
FILES = {
    "tanks.py": TANKS,
    "pi.py": "K = 0.5\n",
    "lib/__init__.py": "",
    "lib/inner.py": "from . import outer\ngain = 1\n",
    "lib/outer.py": "from .deep.below import *\n",
    "lib/deep/__init__.py": "",
    "lib/deep/below.py": "x = 1\n",
    "table.npz": "numbers",
    "unused.py": "x = 1\n",
}


def written(directory, **changed):
    """Write the files into a directory and return the first one."""
    for name, text in {**FILES, **changed}.items():
        path = directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return directory / "tanks.py"


THROUGH_THE_BENCH = {
    "from rmpc_bench.adapters.filterpy import filterpy_estimator": {"filterpy"},
    "def f():\n    from rmpc_bench.adapters import do_mpc": {"casadi", "do_mpc"},
    "import rmpc_bench.adapters.casadi as symbols": {"casadi"},
    "from rmpc_bench.extras import library as get\ndef f(): return get('fmu', 'simulation')": {"fmpy"},
    "from rmpc_bench import extras\ncontrol = extras.library('control')": {"control"},
    "from rmpc_bench.extras import library\nlibrary('nothing')": set(),
    "from rmpc_bench import single_run": set(),
}


@pytest.mark.parametrize("text", THROUGH_THE_BENCH)
def test_libraries_that_are_reached_through_the_bench(tmp_path, text):
    """An adapter names its library, also where one adapter uses another; nothing is imported."""
    assert {*read_source(written(tmp_path, **{"tanks.py": text})).modules} == THROUGH_THE_BENCH[text]


def test_every_local_module_is_found_and_nothing_is_imported(tmp_path):
    """Neighbours, packages, relative imports and imports inside a function; the standard library does not count."""
    source = read_source(written(tmp_path))
    assert [file.place for file in source.files] == [
        "tanks.py",
        "lib/__init__.py",
        "lib/deep/__init__.py",
        "lib/deep/below.py",
        "lib/inner.py",
        "lib/outer.py",
        "pi.py",
        "table.npz",
    ]
    assert source.modules == ("filterpy", "numpy")
    assert not source.problems and not source.warnings
    assert not {"pi", "lib", "tanks"} & set(sys.modules)


@pytest.mark.parametrize("name", [name for name in FILES if name not in ("unused.py", "table.npz")])
def test_an_edit_counts_wherever_it_is(tmp_path, name):
    """Comments do not; the time of the change and the length of the file are the same."""
    path = written(tmp_path)
    before = read_source(path).sha
    edited = tmp_path / name
    text = edited.read_text()
    edited.write_text(text + "# why\n")
    assert read_source(path).sha == before
    edited.write_text(text + "y = 1\n")
    first = read_source(path).sha
    edited.write_text(text + "y = 2\n")
    assert len({before, first, read_source(path).sha}) == 3


def test_a_data_file_counts_and_a_module_that_is_not_imported_does_not(tmp_path):
    path = written(tmp_path)
    before = read_source(path).sha
    (tmp_path / "unused.py").write_text("x = 2")
    assert read_source(path).sha == before
    (tmp_path / "table.npz").write_text("other numbers")
    assert read_source(path).sha != before


def test_the_path_does_not_count(tmp_path):
    """Neither the directory nor the name of the file; which neighbour has which content does."""
    first, second = tmp_path / "first", tmp_path / "a b" / "second"
    first.mkdir(), second.mkdir(parents=True)
    before = read_source(written(first)).sha
    moved = written(second).rename(second / "reactors.py")
    assert read_source(moved).sha == before
    swapped = {"lib/inner.py": FILES["pi.py"], "pi.py": FILES["lib/inner.py"]}
    assert read_source(written(second, **swapped)).sha != before


def test_a_cycle_of_imports_ends(tmp_path):
    path = written(tmp_path, **{"pi.py": "import tanks\nK = 1"})
    assert [file.place for file in read_source(path).files].count("tanks.py") == 1


def test_what_the_syntax_tree_cannot_show_is_named(tmp_path):
    """With its place; files that are written, and those under `depends_on`, are left out."""
    text = """import numpy as np, importlib
from ctypes import CDLL
exec("x = 1")
np.load("other.npz")
np.load("table.npz")
depends_on = ["table.npz"]
open(name, "w")
open("settings.json").read()
__import__("pi")
value = eval("1")
path.read_text("utf-8")
"""
    path = tmp_path / "hidden.py"
    path.write_text(text)
    (tmp_path / "table.npz").write_text("numbers")
    source = read_source(path)
    found = {(warning.line, warning.message.partition(":")[0]) for warning in (*source.warnings, *source.readings)}
    assert found == {
        (1, "import importlib"),
        (2, "import ctypes"),
        (3, "exec()"),
        (4, "numpy.load('other.npz')"),
        (8, "open('settings.json')"),
        (9, "__import__()"),
        (10, "eval()"),
        (11, "path.read_text('utf-8')"),
    }


def test_wrong_files_are_problems_with_their_place(tmp_path):
    """Syntax, a missing file, and names that are not literal."""
    path = tmp_path / "wrong.py"
    path.write_text("import pi\ndef f():\n  depends_on = ['no.npz']\n\nclass A:\n  depends_on = NAMES\n")
    (tmp_path / "pi.py").write_text("K = = 1\n")
    found = {(problem.file, problem.line, problem.message) for problem in read_source(path).problems}
    assert found == {
        (str(path), 3, "depends_on: there is no file 'no.npz' beside it"),
        (str(path), 6, "depends_on must be a list of names of files"),
        (str(tmp_path / "pi.py"), 1, "is not valid Python: invalid syntax"),
    }


def test_a_module_on_the_path_of_python_counts_unless_it_is_installed(tmp_path, monkeypatch):
    """An editable installation has the same version after an edit."""
    shared = tmp_path / "shared"
    (shared / "my_lib").mkdir(parents=True)
    (shared / "my_lib" / "__init__.py").write_text("from my_lib.gains import K")
    (shared / "my_lib" / "gains.py").write_text("K = 1")
    (tmp_path / "here").mkdir()
    path = tmp_path / "here" / "own.py"
    path.write_text("import my_lib, numpy, rmpc_bench, os")
    monkeypatch.syspath_prepend(str(shared))
    before = read_source(path)
    assert before.modules == ("numpy",)
    assert [(file.place, file.beside) for file in before.files[1:]] == [
        ("my_lib/__init__.py", False),
        ("my_lib/gains.py", False),
    ]
    (shared / "my_lib" / "gains.py").write_text("K = 2")
    assert read_source(path).sha != before.sha
    assert local_directory("my_lib") == shared and local_directory("numpy") is None


def test_the_distribution_of_a_module():
    """Also where its name is another one."""
    import filterpy
    import yaml

    assert distribution_of("filterpy") == ("filterpy", filterpy.__version__)
    assert distribution_of("yaml") == ("pyyaml", yaml.__version__)
    assert distribution_of("no_such_module") is None


def test_copies_keep_the_paths_relative_to_each_other(tmp_path):
    """Also of a package above the file; the copies have the same hash."""
    (tmp_path / "lab" / "filters").mkdir(parents=True)
    for name in ("lab/__init__.py", "lab/filters/__init__.py"):
        (tmp_path / name).write_text("")
    (tmp_path / "lab" / "gains.py").write_text("K = 1")
    path = tmp_path / "lab" / "filters" / "own.py"
    path.write_text("from ..gains import K\nfrom . import other")
    (tmp_path / "lab" / "filters" / "other.py").write_text("")
    source = read_source(path)
    assert source.copy == "filters/own.py"
    assert [*source.copies] == [
        "filters/own.py",
        "__init__.py",
        "gains.py",
        "filters/__init__.py",
        "filters/other.py",
    ]
    for place, file in source.copies.items():
        copy = tmp_path / "copies" / place
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(file.content)
    assert read_source(tmp_path / "copies" / source.copy).sha == source.sha
    assert read_source(written(tmp_path)).copy == "tanks.py"
