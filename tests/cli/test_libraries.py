"""What the command line does not load of other libraries, and that they work as usual all the same."""

import subprocess
import sys

import pytest

LOAD = "import sys\nfrom rmpc_bench.cli.run import load_libraries\n"
ARTISTS = "from rmpc_bench.figures.style import without_docstrings_of_artists\n"


def fresh(program, *arguments):
    """Run a program in a process of its own, in which nothing is loaded yet."""
    command = [sys.executable, "-c", program, *map(str, arguments)]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


def test_scipy_without_parts_of_numpy():
    """The modules are not loaded with SciPy, and are the real ones when they are asked for."""
    fresh(
        LOAD + "load_libraries()\n"
        "assert not {'numpy.f2py', 'numpy.testing', 'unittest', 'asyncio', 'pydoc'} & {*sys.modules}\n"
        "import numpy, scipy.linalg\n"
        "numpy.testing.assert_allclose(scipy.linalg.expm(numpy.zeros((2, 2))), numpy.eye(2))\n"
        "assert numpy.f2py.get_include\n"
        "load_libraries()\n"
        "assert numpy.testing.assert_allclose\n"
        "import jaxtyping, unittest.mock, scipy.special\n"
        "assert unittest.mock.patch and 'Schur' in scipy.linalg.schur.__doc__ and scipy.special.ndtri.__doc__\n"
        "from scipy._lib._docscrape import FunctionDoc\n"
        "assert FunctionDoc(scipy.linalg.schur)['Parameters']\n"
    )


def test_artists_without_docstrings():
    """They have no docstring of `set`, which works, and others are as written; those defined later have all of them."""
    fresh(
        ARTISTS + "with without_docstrings_of_artists():\n"
        "    from matplotlib.figure import Figure\n"
        "from matplotlib.lines import Line2D\n"
        "assert Line2D.set.__doc__ is None and '%(Text:kwdoc)s' in Figure.text.__doc__\n"
        "line, = Figure().subplots().plot([0, 1])\n"
        "line.set(lw=3, color='red')\n"
        "assert line.get_linewidth() == 3\n"
        "class Own(Line2D): pass\n"
        "from matplotlib.artist import Artist\n"
        "class Other(Artist): pass\n"
        "assert 'Set multiple properties' in Other.set.__doc__\n"
        "from matplotlib._docstring import interpd\n"
        "@interpd\n"
        "def text(): '%(Text:kwdoc)s'\n"
        "assert 'fontsize' in text.__doc__\n"
    )


def test_numba_without_coverage():
    """The package of that name, which numba would load, is not loaded with the kernels, unless it was before."""
    kernels = "from rmpc_bench.numerics.compiled import numba\nfrom numba.misc import coverage_support\n"
    fresh("import sys\n" + kernels + "assert 'coverage' not in sys.modules\nimport coverage\n")
    fresh("import coverage\n" + kernels + "assert coverage_support.coverage is coverage\n")


def test_fonts_without_parts_of_fonttools():
    """What a PDF has no use for is not loaded, and is the real module when it is asked for."""
    fresh(
        "import sys\n"
        "from rmpc_bench.figures.files import small_fonts\n"
        "with small_fonts():\n"
        "    from fontTools import subset\n"
        "assert not {'fontTools.varLib.merger', 'fontTools.subset.svg', 'lxml'} & {*sys.modules}\n"
        "import fontTools.varLib.models, fontTools.varLib.multiVarStore, fontTools.subset.svg\n"
        "assert fontTools.varLib.models.normalizeValue and fontTools.varLib.multiVarStore and fontTools.varLib.build\n"
        "assert fontTools.subset.svg.subset_elements\n"
    )


def test_a_fonttools_that_needs_what_is_left_out(tmp_path):
    """It is loaded as usual."""
    for file, content in {
        "__init__.py": "",
        "subset.py": "from fontTools.varLib import build\ndef load_font(): pass\n",
        "varLib.py": "build = 1\n",
    }.items():
        (tmp_path / "fontTools").mkdir(exist_ok=True)
        (tmp_path / "fontTools" / file).write_text(content, encoding="utf-8")
    fresh(
        "import sys\nsys.path.insert(0, sys.argv[1])\n"
        "from rmpc_bench.figures.files import small_fonts\n"
        "with small_fonts():\n"
        "    from fontTools import subset\n"
        "assert subset.__file__.startswith(sys.argv[1]) and subset.build == 1\n",
        tmp_path,
    )


@pytest.mark.parametrize(
    "content", ["import numpy\nnumpy.testing.assert_allclose", "from numpy.testing import assert_allclose"]
)
def test_a_scipy_that_needs_what_is_left_out(tmp_path, content):
    """It is loaded as usual by the import that follows."""
    (tmp_path / "scipy").mkdir()
    (tmp_path / "scipy" / "__init__.py").touch()
    (tmp_path / "scipy" / "linalg.py").write_text(content, encoding="utf-8")
    fresh(
        LOAD + "sys.path.insert(0, sys.argv[1])\nload_libraries()\nimport scipy.linalg, numpy\n"
        "assert scipy.linalg.__file__.startswith(sys.argv[1]) and numpy.testing.assert_allclose\n",
        tmp_path,
    )


def test_a_matplotlib_without_the_name():
    """Nothing is left behind."""
    fresh(
        ARTISTS + "from matplotlib.figure import Artist\n"
        "import matplotlib._docstring\n"
        "del Artist._update_set_signature_and_docstring\n"
        "del matplotlib._docstring._ArtistPropertiesSubstitution\n"
        "with without_docstrings_of_artists(): pass\n"
        "assert not hasattr(Artist, '_update_set_signature_and_docstring')\n"
    )


def test_late_methods_of_dataclasses():
    """They are those of a usual dataclass."""
    fresh(
        "import dataclasses, inspect, sys\n"
        "__name__ = 'rmpc_bench.module'\n"
        "sys.modules[__name__] = sys.modules['__main__']\n"
        "def made():\n"
        "    @dataclasses.dataclass(frozen=True, order=True)\n"
        "    class Pair:\n"
        "        a: int\n"
        "        b: str = 'x'\n"
        "    return Pair\n"
        "usual = made()\n"
        "from rmpc_bench.cli import late_methods\n"
        "late_methods()\n"
        "late = made()\n"
        "one, two = late(1), late(2)\n"
        "assert one == late(1) != two and one < two <= late(2) and one != usual(1)\n"
        "assert (hash(one), repr(one)) == (hash(usual(1)), repr(usual(1)))\n"
        "assert inspect.signature(late) == inspect.signature(usual)\n"
        "assert not hasattr(dataclasses, '_create_fn') or late.__eq__.__code__.co_name == 'late'\n"
        "for change in (lambda: setattr(one, 'a', 3), lambda: delattr(one, 'b')):\n"
        "    try:\n"
        "        change()\n"
        "    except dataclasses.FrozenInstanceError:\n"
        "        continue\n"
        "    raise AssertionError\n"
    )


def test_a_dataclass_of_a_user_is_sent_by_value():
    """As it is without the command line."""
    fresh(
        "import pickle\n"
        "from rmpc_bench.cli import late_methods\n"
        "from rmpc_bench.components.transport import dumps, loads\n"
        "late_methods()\n"
        "from dataclasses import dataclass\n"
        "def made():\n"
        "    @dataclass(frozen=True)\n"
        "    class Level:\n"
        "        h: float\n"
        "    return Level(1.5)\n"
        "data, text = dumps(made()), repr(made())\n"
        "assert repr(loads(data)) == text\n"
    )
