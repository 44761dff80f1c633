"""Kernels are compiled and computed whether or not a directory for the compiled code is writable."""

import errno

import pytest
from numba.core import caching

from rmpc_bench.numerics.code_cache import WITHOUT_FILE, cache_remark
from rmpc_bench.numerics.compiled import compiled


def double(x):
    return 2 * x


@pytest.fixture(autouse=True)
def forgotten():
    """The kernels of one test are not those of the next."""
    yield
    WITHOUT_FILE.clear()


def test_compiled_code_is_kept(monkeypatch, tmp_path):
    """In the directory that the user names; numba reads NUMBA_CACHE_DIR once, when it is imported."""
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    kernel = compiled(error_model="numpy")(double)
    assert kernel(3) == 6
    assert [path.suffix for path in sorted(tmp_path.rglob("*.nb*"))] == [".nbc", ".nbi"]
    assert cache_remark() == ""


def test_without_a_writable_directory(monkeypatch):
    """numba refuses such a function with cache=True; it is compiled without."""
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    kernel = compiled()(double)
    assert kernel(3) == 6
    assert kernel.stats.cache_path is None
    assert "NUMBA_CACHE_DIR" in cache_remark() and "\n" not in cache_remark()


def test_full_disk(monkeypatch, tmp_path):
    """Compiled code that cannot be written ends no computation."""
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))

    def full(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(caching.IndexDataCacheFile, "save", full)
    assert compiled()(double)(3) == 6
    assert "NUMBA_CACHE_DIR" in cache_remark()
