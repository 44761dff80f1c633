"""Cost of the identity of a Python file: about 1 ms when it has been read before.  Run with `make perf`."""

import pytest

from rmpc_bench.components import source

pytestmark = pytest.mark.perf
FUNCTION = '''
def gain_{i}(x, u):
    """A gain."""
    return [0.5 * x[0] + {i} * u[0], np.sqrt(abs(x[1]))]
'''


@pytest.fixture
def path(tmp_path):
    """Return a file of 300 lines with three neighbours."""
    text = "import numpy as np\n" + "".join(FUNCTION.format(i=i) for i in range(60))
    for name in ("a", "b", "c"):
        (tmp_path / f"{name}.py").write_text(text)
    (tmp_path / "own.py").write_text("import a, b, c\n" + text)
    return tmp_path / "own.py"


def test_hash_of_four_files_read_before(benchmark, path):
    """Nothing is parsed again."""
    first = source.read_source(path).sha
    assert benchmark(lambda: source.read_source(path).sha) == first


def test_hash_of_four_new_files(benchmark, path):
    """Every file is parsed."""

    def cold():
        source._parsed.cache_clear()
        return len(source.read_source(path).files)

    assert benchmark(cold) == 4
