"""Files of a user as modules: neighbours, equal names in two directories, edits, and what Python files may contain."""

import sys
from importlib.machinery import EXTENSION_SUFFIXES

import pytest
from own_files import ESTIMATOR, own_estimator, write

from rmpc_bench.components.loading import load, module_of
from rmpc_bench.components.reference import CodeError, CodeReference
from rmpc_bench.components.source import read_source


def loaded(directory, name, **files):
    """Write files and load a name of the first one."""
    for stem, text in files.items():
        path = directory / f"{stem}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    first = (directory / f"{next(iter(files))}.py").resolve()
    return load(CodeReference(first, name, f"{first.name}:{name}"))


def test_a_compiled_neighbour_comes_before_its_source(tmp_path):
    """As in Python, and as in the hash.  Trap: one file is hashed and the other one is loaded."""
    compiled = tmp_path / f"gains{EXTENSION_SUFFIXES[0]}"
    compiled.write_bytes(b"no library")
    with pytest.raises(CodeError, match="ImportError"):
        loaded(tmp_path, "K", top="from gains import K", gains="K = 1")
    assert [each.path for each in read_source(tmp_path / "top.py").files[1:]] == [compiled]


def test_an_import_at_every_sample_searches_once(tmp_path, monkeypatch):
    """Trap: a search beside the file takes 100 us, a second import of a module less than 1 us."""
    function = loaded(tmp_path, "f", top="def f():\n    import numpy\n    from scipy.linalg import expm\n")
    function()
    for place in ("importlib.util", "rmpc_bench.components.loading"):
        monkeypatch.setattr(f"{place}.find_spec", lambda name: pytest.fail(f"searches for {name}"))
    function()


def test_neighbours_by_plain_name_and_with_a_point(tmp_path):
    """All forms of the import statement, at the top and in a function, also from neighbours and packages."""
    top = """
import second
import parts.tank
import parts.tank as tank
from parts import tank as other
from parts.deep.inner import VALUE
from . import second as relative
from .second import ONE
def f():
    import late
    from parts.deep import inner
    return late.LATE, inner.VALUE
result = (second.ONE, parts.tank.TANK, tank is other is parts.tank, VALUE, relative is second, ONE)
"""
    result = loaded(
        tmp_path,
        "result",
        top=top,
        second="import third\nONE = third.THREE - 2",
        third="THREE = 3",
        late="LATE = 'late'",
        **{
            "parts/tank": "from .deep import inner\nimport second\nTANK = inner.VALUE + second.ONE",
            "parts/deep/inner": "VALUE = 10",
            "parts/deep/__init__": "",
        },
    )
    assert result == (1, 11, True, 10, True, 1)
    assert loaded(tmp_path, "f", top=top)() == ("late", 10)


def test_equal_names_in_two_directories_do_not_mix(tmp_path):
    """The naive version, the directory on sys.path, gives the second file the neighbour of the first."""
    top = "import neighbour\ndef f():\n    import lazy\n    return neighbour.NAME, lazy.NAME\n"
    found = {
        name: loaded(tmp_path / name, "f", top=top, neighbour=f"NAME = {name!r}", lazy=f"NAME = '{name} lazy'")
        for name in ("one", "two")
    }
    assert {name: f() for name, f in found.items()} == {"one": ("one", "one lazy"), "two": ("two", "two lazy")}
    assert not {"top", "neighbour", "lazy"} & set(sys.modules)
    assert not {str(tmp_path / "one"), str(tmp_path / "two")} & set(sys.path)


def test_other_modules_do_not_see_the_neighbours(tmp_path):
    """A file with the name of a library hides it from the files beside it only, and may import the library itself."""
    text = "import json\nimport colorsys\nimport stat\ntext = json.dumps({}), colorsys.MINE, stat.MINE"
    mine = "from colorsys import rgb_to_hls\nMINE = 1"
    result = loaded(tmp_path, "text", top=text, colorsys=mine, stat="from os import stat\nMINE = stat is not None")
    assert result == ("{}", 1, True)
    import colorsys

    assert not hasattr(colorsys, "MINE")


def test_a_directory_without_init_counts_after_installed_packages(tmp_path):
    """As everywhere in Python: a directory of data named numpy hides nothing."""
    (tmp_path / "numpy").mkdir()
    assert loaded(tmp_path, "value", top="import numpy\nvalue = numpy.ones(1)[0]") == 1.0


def test_a_directory_without_init_counts_after_files(tmp_path):
    """Also after a file beside one in a package, which is what the hash has, and where it is a module already."""
    files = {"parts/__init__": "", "parts/one": "import data\nN = data.N", "parts/data": "N = 1", "data/notes": ""}
    assert loaded(tmp_path, "N", top="from parts.one import N", **files) == 1
    assert tmp_path / "parts" / "data.py" in [each.path for each in read_source(tmp_path / "top.py").files]
    files = {"second": "import colorsys\nfound = hasattr(colorsys, 'rgb_to_hls')", "colorsys/mine": "X = 1"}
    assert loaded(tmp_path, "found", first="from .colorsys import mine\nfrom second import found", **files)


def test_an_edit_counts_at_once_and_old_objects_stay(tmp_path):
    """Also of a neighbour, with the same length and within a second; no compiled file is written."""
    one = loaded(tmp_path, "f", top="import second\ndef f(): return second.X", second="X = 1")
    again = loaded(tmp_path, "f", top="import second\ndef f(): return second.X")
    assert again is one
    two = loaded(tmp_path, "f", top="import second\ndef f(): return second.X", second="X = 2")
    assert (one(), two()) == (1, 2)
    assert not (tmp_path / "__pycache__").exists()


def test_a_missing_neighbour_is_an_error_of_the_import(tmp_path):
    """With the name that the file asks for, not a private one."""
    from rmpc_bench.components.reference import CodeError

    with pytest.raises(CodeError, match="ModuleNotFoundError: No module named 'secnd'"):
        loaded(tmp_path, "x", top="import secnd", second="")
    with pytest.raises(CodeError, match="cannot import name 'y' from 'second'"):
        loaded(tmp_path, "x", top="from second import y", second="")


def test_ordinary_python(tmp_path):
    """Dataclasses, future annotations, pickles of own classes, an encoding, `__file__` and `__name__`."""
    text = """# -*- coding: latin-1 -*-
from __future__ import annotations
import pickle
from dataclasses import dataclass
from pathlib import Path
@dataclass(frozen=True)
class Record:
    x: list[float]
    y: Record | None = None
same = pickle.loads(pickle.dumps(Record([1.0]))) == Record([1.0])
here = Path(__file__).name
main = __name__ == "__main__"
result = same, here, main
"""
    assert loaded(tmp_path, "result", top=text) == (True, "top.py", False)


def test_a_compiled_function_of_a_user(tmp_path):
    """numba finds the source of the function and the names in its module."""
    text = "import math\nimport numba\nfrom second import K\n@numba.njit\ndef f(x): return K * math.sqrt(x)\n"
    assert loaded(tmp_path, "f", top=text, second="K = 2.0")(4.0) == 4.0


def test_a_module_is_imported_once(tmp_path):
    """Whatever number of its names is used."""
    path = write(tmp_path, {"own.py": "print('once')\n" + ESTIMATOR + "\nOther = Own\n"})
    module = module_of(path.with_name("own.py").resolve())
    assert module_of(path.with_name("own.py").resolve()) is module
    assert type(own_estimator(path)) is module.Own
