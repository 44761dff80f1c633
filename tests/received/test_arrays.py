"""Files of numbers from elsewhere: what is read, and what is refused before memory is taken for it."""

import io
import math
import resource
import struct
import time
import zipfile
import zlib

import numpy as np
import pytest
import scipy.io
import scipy.sparse

from rmpc_bench.packing.comparison import read_rows
from rmpc_bench.received.arrays import MAX_COLUMNS, MAX_ENTRIES, ArrayFileError, columns, matrices

VALUES = {
    "A": np.array([[0.9, 0.1], [0.0, 0.8]]),
    "whole": np.arange(-3, 3, dtype=np.int16).reshape(2, 3),
    "single": np.float32([[1.5, -2.5]]),
    "flags": np.array([[True, False, True]]),
    "z": np.array([[1 + 2j]]),
    "empty": np.zeros((0, 3)),
}
OTHERS = {"text": "word", "cell": np.array([[1, "a"]], dtype=object), "struct": {"x": 1}, "sp": scipy.sparse.eye(3)}


def header(shape, descr="<f8"):
    """The first bytes of a .npy file."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def npz(content, name="A.npy", times=1):
    """An archive of one content under some names."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(times):
            archive.writestr(name if times == 1 else f"{number}", content)
    return stream.getvalue()


def element(kind, data):
    """An element of a MATLAB file of version 5."""
    return struct.pack("<2I", kind, len(data)) + data + bytes(-len(data) % 8)


def variable(shape, rest, mat_class=6):
    """A matrix called A, which goes on with any bytes."""
    sizes = struct.pack(f"<{len(shape)}i", *shape)
    flags = struct.pack("<2I", mat_class, 0)
    return element(14, element(6, flags) + element(5, sizes) + element(1, b"A") + rest)


def mat(*elements):
    """A MATLAB file of version 5."""
    return b"MATLAB 5.0".ljust(124) + struct.pack("<H", 0x100) + b"IM" + b"".join(elements)


def saved(values, **options):
    """What SciPy writes."""
    stream = io.BytesIO()
    scipy.io.savemat(stream, values, **options)
    return stream.getvalue()


@pytest.mark.filterwarnings("ignore:The default value for `spmatrix`:DeprecationWarning")  # of the oracle, SciPy 1.18
@pytest.mark.parametrize("options", [{}, {"do_compression": True}, {"format": "4"}])
def test_numbers_of_matlab_files(options):
    """Oracle: SciPy reads the same from its own files; what are no full matrices of numbers have no numbers."""
    old = options.get("format") == "4"
    values = {"A": VALUES["A"], "whole": VALUES["whole"]} if old else VALUES
    content = saved(values | ({} if old else OTHERS), **options)
    there = scipy.io.loadmat(io.BytesIO(content))
    found = matrices(content, ".mat", "m")
    assert found.keys() == {name for name in there if name[:2] != "__"}
    for name in values:
        np.testing.assert_array_equal(found[name], there[name])
    assert all(found[name].dtype == object for name in found.keys() - values.keys())


def test_a_matlab_file_of_the_other_order_of_bytes():
    values = np.arange(6.0).reshape(2, 3)
    data = values.astype(">f8").tobytes(order="F")
    parts = [(6, struct.pack(">2I", 6, 0)), (5, struct.pack(">2i", 2, 3)), (1, b"A"), (9, data)]
    inside = b"".join(struct.pack(">2I", kind, len(each)) + each + bytes(-len(each) % 8) for kind, each in parts)
    content = b"MATLAB 5.0".ljust(124) + struct.pack(">H", 0x100) + b"MI" + struct.pack(">2I", 14, len(inside)) + inside
    np.testing.assert_array_equal(matrices(content, ".mat", "m")["A"], values)
    np.testing.assert_array_equal(scipy.io.loadmat(io.BytesIO(content))["A"], values)


def complex_of_bytes():
    """A MATLAB file whose double numbers are stored as bytes, which take 32 times their room."""
    n = 45_000_000
    flags, sizes = struct.pack("<2I", 6 | 0x800, 0), struct.pack("<2i", n, 1)
    parts = element(6, flags) + element(5, sizes) + element(1, b"A") + 2 * element(1, bytes(n))
    return mat(element(15, zlib.compress(element(14, parts), 1)))


BOMBS = {
    "header that lies": (".npz", lambda: npz(header((1_000_000, 1_000_000))), "states the shape"),
    "negative shape": (".npz", lambda: npz(header((-1, -1)) + bytes(8)), "states the shape"),
    "too much data": (".npz", lambda: npz(header((1,)) + bytes(16)), "states the shape"),
    "objects": (".npz", lambda: npz(header((1,), "|O") + b"cos\nsystem\n"), "Python objects"),
    "300 MB of zeros": (".npz", lambda: npz(header((300_000_000,), "|u1") + bytes(300_000_000)), "300 MB"),
    "small entries": (".npz", lambda: npz(header((90_000_000,), "|b1") + bytes(90_000_000)), "720 MB"),
    "deep header": (".npz", lambda: npz(b"\x93NUMPY\x01\x00" + struct.pack("<H", 9000) + b"(" * 9000), "numpy.savez"),
    "no array": (".npz", lambda: npz(b"hello"), "numpy.savez"),
    "many arrays": (".npz", lambda: npz(b"", times=20_000), "20000 arrays"),
    "matrix that lies": (".mat", lambda: mat(variable((30_000, 30_000), element(9, bytes(8)))), "MATLAB"),
    "part that lies": (".mat", lambda: mat(variable((1, 1), struct.pack("<2I", 9, 0xFFFFFFF0))), "MATLAB"),
    "negative sizes": (".mat", lambda: mat(variable((-1, -1), element(9, bytes(8)))), "MATLAB"),
    "zlib bomb": (
        ".mat",
        lambda: mat(element(15, zlib.compress(variable((1, 1), element(9, bytes(150_000_000))), 1))),
        "MB or more",
    ),
    "complex of small entries": (".mat", complex_of_bytes, "MB or more"),
    "many matrices": (".mat", lambda: mat(*[variable((1, 1), element(9, bytes(8)))] * 20_000), "arrays, more than"),
    "old and large": (".mat", lambda: struct.pack("<5i", 0, 1 << 30, 1 << 30, 0, 2) + b"A\0", "larger than the file"),
    "old and zero": (".mat", lambda: bytes(1_000_000), "MATLAB"),
    "version 7.3": (".mat", lambda: b"".ljust(124) + struct.pack("<H", 0x200) + b"IM", "-v7"),
    "wide": (".csv", lambda: b"1," * 3_000_000 + b"1", f"more than {MAX_ENTRIES} entries"),
    "tall": (".csv", lambda: b"1\n" * 5_000_000, f"more than {MAX_ENTRIES} entries"),
    "long field": (".csv", lambda: b'"' + b"1" * 10_000_000, "rows of equally many numbers"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused_at_once(name):
    suffix, make, text = BOMBS[name]
    content, before = make(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    with pytest.raises(ArrayFileError, match=text):
        matrices(content, suffix, "m")
    assert time.process_time() - start < 2.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000  # kB


TABLES = {
    "wide": (lambda: b"1," * 3_000_000 + b"1", f"columns, more than {MAX_COLUMNS}"),
    "names": (lambda: ",".join(f"c{i}" for i in range(1_000_000)).encode(), f"columns, more than {MAX_COLUMNS}"),
    "wide second line": (lambda: b"y\n" + b"1," * 3_000_000, "line 2 has 3000001 cells, and there are 1 columns"),
    "long field": (lambda: b'y\n"' + b"1" * 10_000_000, "field larger than field limit"),
    "long name": (lambda: b"y" * 10_000_000, "field larger than field limit"),
    "word at the end": (lambda: b"y\n" + b"1\n" * 1_000_000 + b"x\n", "line 1000002: 'x' in the column 'y'"),
    "word after a number": (lambda: b"y,u\n1,2\n3,x\n", "line 3: 'x' in the column 'u'"),
    "two columns of a name": (lambda: b"y,y\n1,2\n", "two columns of the name 'y'"),
    "blank lines": (lambda: b"\n" * 1_000_000, "is empty"),
    "bytes": (lambda: bytes(range(256)), "cannot be read"),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_that_is_none_is_refused_at_once(tmp_path, name):
    make, text = TABLES[name]
    path = tmp_path / "t.csv"
    path.write_bytes(make())
    start = time.process_time()
    with pytest.raises(ArrayFileError, match=text):
        columns(path)
    assert time.process_time() - start < 2.0


def test_packed_rows_with_too_many_columns_are_refused(tmp_path):
    """pandas needs more than ten minutes for 700,000 columns."""
    path = tmp_path / "trials.csv"
    path.write_text("method,run," + ",".join(f"c{i}" for i in range(700_000)) + "\n")
    with pytest.raises(ArrayFileError, match=r"trials\.csv has 700002 columns, more than 10000"):
        read_rows(path)


def test_columns_of_a_table(tmp_path):
    """An empty cell is NaN; empty lines are left out."""
    path = tmp_path / "t.csv"
    path.write_text("\ufefft,y\n0,1\n\n1,\n2, 3 \n", encoding="utf-8")
    found = columns(path)
    np.testing.assert_array_equal(found["y"], [1.0, math.nan, 3.0])
    np.testing.assert_array_equal(found["t"], [0.0, 1.0, 2.0])
    np.savez(tmp_path / "t.npz", y=np.arange(6).reshape(3, 2), words=np.array(["a"]))
    assert columns(tmp_path / "t.npz").keys() == {"y.0", "y.1"}
    (tmp_path / "lie.npz").write_bytes(npz(header((10**6, 10**6))))
    with pytest.raises(ArrayFileError, match="states the shape"):
        columns(tmp_path / "lie.npz")


@pytest.mark.parametrize("options", [{}, {"do_compression": True}, {"format": "4"}, None])
def test_any_damage_ends_in_a_message(options):
    """Bytes of good files replaced by chance.  The compiled reader of SciPy crashes on some of them."""
    rng = np.random.default_rng(33)
    stream = io.BytesIO()
    np.savez(stream, A=VALUES["A"], b=np.arange(4))
    good = stream.getvalue() if options is None else saved({"A": VALUES["A"], "b": VALUES["whole"]}, **options)
    suffix = ".npz" if options is None else ".mat"
    for _ in range(300):
        content = bytearray(good)
        for place in rng.integers(0, len(good), 3):
            content[place : place + 4] = rng.integers(0, 256, 4, dtype=np.uint8).tobytes()
        try:
            matrices(bytes(content[: rng.integers(1, 2 * len(good))]), suffix, "m")
        except ArrayFileError as error:
            assert len(str(error)) < 300
