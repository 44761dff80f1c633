"""Numbers from files that somebody else may have made: matrices and recorded columns of .mat, .npz and .csv files.

The size that a header states is compared with that of the data before memory is taken for it.  Nothing is unpickled.
"""

from __future__ import annotations

import csv
import math
import struct
import zlib
from array import array
from io import BytesIO, StringIO
from pathlib import Path
from typing import IO
from zipfile import ZipFile, ZipInfo

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array

MAX_UNPACKED = 100_000_000
"""Largest size of all arrays of a file [bytes]; files larger than a tenth of it may expand tenfold."""
MAX_ENTRIES = 100_000  # largest number of entries of a matrix of a configuration
MAX_COLUMNS = 10_000
_MOST_ARRAYS = 10_000
_MATRIX, _COMPRESSED, _OPAQUE, _IS_COMPLEX = 14, 15, 17, 0x800
"""Of a MATLAB file of version 5: types of elements, the class of objects without sizes, a flag."""
_NO_NUMBERS = {1: "a cell array", 2: "a struct", 4: "text", 5: "a sparse matrix", 16: "a function"}
_CLASSES = dict(zip(range(6, 16), ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"), strict=True))
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_PRECISIONS = {0: "f8", 1: "f4", 2: "i4", 3: "i2", 4: "u2", 5: "u1"}
_LARGEST_TYPE = 5000  # above the types of matrices of version 4, so that the order of the bytes is seen


class ArrayFileError(ValueError):
    """A file that is no such file of numbers, or that is too large."""


def matrices(content: bytes, suffix: str, stem: str) -> dict[str, Array]:
    """Return the arrays of a file by their names; a .csv file without a heading has one, with its own name."""
    if suffix == ".csv":
        return _csv_matrix(content, stem)
    return _mat(content) if suffix == ".mat" else _npz(BytesIO(content), len(content))


def columns(file: Path) -> dict[str, Float[Array, " samples"]]:
    """Return the columns of a .csv or .npz file by their names."""
    if file.exists() and not file.is_file():
        raise ArrayFileError("is not a regular file")
    try:
        table = _csv_columns(file) if file.suffix.lower() == ".csv" else _npz_columns(file)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ArrayFileError(f"cannot be read ({error})") from None
    lengths = {len(column) for column in table.values()}
    if len(lengths) > 1:
        raise ArrayFileError(f"has columns of different lengths ({', '.join(map(str, sorted(lengths)))})")
    if not table or lengths == {0}:
        raise ArrayFileError("has no samples")
    return table


def check_width(file: Path) -> None:
    """Refuse a .csv file with too many columns, for which the readers of libraries need hours."""
    with file.open("rb") as opened:
        n_columns = 1 + max((line.count(b",") for line in opened), default=0)
    if n_columns > MAX_COLUMNS:
        raise ArrayFileError(f"{file.name} has {n_columns} columns, more than {MAX_COLUMNS}")


def _npz_columns(file: Path) -> dict[str, Array]:
    """One column per array of numbers, or per column of it; others are left out."""
    table: dict[str, Array] = {}
    with file.open("rb") as opened:
        arrays = _npz(opened, file.stat().st_size)
    for name, found in arrays.items():
        if found.dtype.kind in "biuf" and found.ndim in (1, 2):
            if found.ndim == 2 and found.shape[1] > MAX_COLUMNS:
                raise ArrayFileError(f"{name} has {found.shape[1]} columns, more than {MAX_COLUMNS}")
            each = {name: found} if found.ndim == 1 else {f"{name}.{i}": column for i, column in enumerate(found.T)}
            table |= {key: column.astype(float) for key, column in each.items()}
    return table


def _npz(file: IO[bytes], packed: int) -> dict[str, Array]:
    """Read an archive of numpy.savez."""
    try:
        with ZipFile(file) as archive:
            entries = archive.infolist()
            _limit(sum(entry.file_size for entry in entries), len(entries), packed)
            found = {entry.filename.removesuffix(".npy"): _npy(archive, entry) for entry in entries}
        _limit(sum(8 * each.size for each in found.values()), len(entries), packed)
        return found
    except (ArrayFileError, OSError):
        raise
    except Exception:
        # The libraries raise errors without a common class for bytes that somebody has chosen.
        raise ArrayFileError("is not an archive of arrays of numbers, as numpy.savez writes it") from None


def _limit(size: int, n_arrays: int, packed: int) -> None:
    """Refuse a file with too many or too large arrays."""
    most = max(MAX_UNPACKED, 10 * packed)
    if size > most:
        raise ArrayFileError(f"has arrays of {size / 1e6:.0f} MB or more; they must have at most {most / 1e6:g} MB")
    if n_arrays > _MOST_ARRAYS:
        raise ArrayFileError(f"has {n_arrays} arrays, more than {_MOST_ARRAYS}")


def _npy(archive: ZipFile, entry: ZipInfo) -> Array:
    """Read an array whose header states the size of its data."""
    with archive.open(entry) as file:
        form = np.lib.format
        readers = {(1, 0): form.read_array_header_1_0, (2, 0): form.read_array_header_2_0}
        shape, _, dtype = readers[form.read_magic(file)](file)
        if dtype.hasobject:
            raise ArrayFileError(f"{entry.filename} has Python objects; only arrays of numbers are read")
        if min(shape, default=0) < 0 or file.tell() + math.prod(shape) * dtype.itemsize != entry.file_size:
            raise ArrayFileError(f"{entry.filename} states the shape {shape}, which is not the size of its data")
    with archive.open(entry) as file:
        found: Array = form.read_array(file, allow_pickle=False)
    return found


def _mat(content: bytes) -> dict[str, Array]:
    """Read a MATLAB file up to version 7.2; what is no full matrix of numbers becomes an object, the word for it."""
    # It is read here, because the compiled reader of SciPy crashes on altered files.
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order and content[125 if order == "<" else 124] == 2:
        raise ArrayFileError("is a file of MATLAB version 7.3 (HDF5); save it with save('file.mat', ..., '-v7')")
    try:
        return _version_5(memoryview(content), order) if order else _version_4(content)
    except ArrayFileError:
        raise
    except (ValueError, KeyError, struct.error, zlib.error) as error:
        raise ArrayFileError(f"is not a MATLAB file ({error})") from None


def _version_5(content: memoryview, order: str) -> dict[str, Array]:
    found: dict[str, Array] = {}
    place, total, number, n_entries = 128, 0, 0, 0
    while place + 8 <= len(content):
        kind, data, after = _part(content, place, order)
        place, number = (place + 8 + len(data) if kind == _COMPRESSED else after), number + 1
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(data, MAX_UNPACKED + 1 - total)
            total += len(unpacked)
            kind, data, _ = _part(memoryview(unpacked), 0, order)
        _limit(total, number, len(content))
        flags = struct.unpack_from(f"{order}I", data, 8)[0]
        _, sizes, after = _part(data, 16, order)
        _, name, after = _part(data, after, order)
        if flags & 0xFF in _CLASSES and kind == _MATRIX:
            shape = struct.unpack(f"{order}{len(sizes) // 4}I", sizes)
            parts = []
            for _ in range(2 if flags & _IS_COMPLEX else 1):
                kind, raw, after = _part(data, after, order)
                numbers = np.frombuffer(raw, f"{order}{_TYPES[kind]}").reshape(shape, order="F")
                n_entries += numbers.size
                _limit(8 * n_entries, number, len(content))
                parts.append(numbers.astype(_CLASSES[flags & 0xFF]))
            found[str(name, "latin-1")] = parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1]
        else:
            # An object has its name in place of its sizes.
            name = sizes if flags & 0xFF == _OPAQUE else name
            found[str(name, "latin-1")] = np.array(_NO_NUMBERS.get(flags & 0xFF, "an object"), dtype=object)
    # The data of objects stand behind all variables and have no name.
    found.pop("", None)
    return found


def _part(data: memoryview, place: int, order: str) -> tuple[int, memoryview, int]:
    """Return type and content of a part, and the place after it; up to four bytes stand inside its tag."""
    kind, size = struct.unpack_from(f"{order}2I", data, place)
    if kind >> 16:
        return kind & 0xFFFF, data[place + 4 : place + 4 + min(kind >> 16, 4)], place + 8
    return kind, data[place + 8 : place + 8 + size], place + 8 + size + -size % 8


def _version_4(content: bytes) -> dict[str, Array]:
    found: dict[str, Array] = {}
    place = 0
    while place < len(content):
        order = "<" if struct.unpack_from("<I", content, place)[0] < _LARGEST_TYPE else ">"
        kind, rows, n, is_complex, length = struct.unpack_from(f"{order}5I", content, place)
        dtype = np.dtype(f"{order}{_PRECISIONS[kind // 10 % 10 if kind < _LARGEST_TYPE else -1]}")
        name = content[place + 20 : place + 20 + length].rstrip(b"\0").decode("latin-1")
        place += 20 + length
        size = rows * n * dtype.itemsize
        if not name or place + size * (1 + bool(is_complex)) > len(content):
            raise ValueError("a matrix is larger than the file")
        numbers = np.frombuffer(content[place : place + size], dtype).reshape((rows, n), order="F")
        other = {0: "a complex matrix" if is_complex else "", 1: "text"}.get(kind % 10, "a sparse matrix")
        found[name] = np.array(other, dtype=object) if other else numbers
        place += size * (1 + bool(is_complex))
        _limit(0, len(found), len(content))
    return found


def _csv_matrix(content: bytes, stem: str) -> dict[str, Array]:
    """Read rows of numbers, or columns below a heading."""
    entries = content.count(b",") + content.count(b"\n")
    if entries > 2 * MAX_ENTRIES:
        raise ArrayFileError(f"has more than {MAX_ENTRIES} entries; a matrix of a configuration has at most as many")
    try:
        lines = StringIO(content.decode("utf-8-sig"), newline="")
        rows = [row for row in csv.reader(lines) if any(cell.strip() for cell in row)]
        heading = [cell.strip() for cell in rows[0]] if rows and not any(map(_is_number, rows[0])) else []
        numbers = np.array([[float(cell) for cell in row] for row in rows[bool(heading) :]])
        return dict(zip(heading, numbers.T, strict=True)) if heading else {stem: numbers}
    except (ValueError, csv.Error):
        text = "must have rows of equally many numbers, with commas between them, below a heading or none"
        raise ArrayFileError(text) from None


def _csv_columns(file: Path) -> dict[str, Array]:
    """Read columns under their names; an empty cell is NaN."""
    with file.open(encoding="utf-8-sig", newline="") as lines:
        first = lines.readline()
        lines.seek(0)
        delimiter = ";" if ";" in first and "," not in first else ","
        rows = enumerate(csv.reader(lines, delimiter=delimiter), start=1)
        names = [cell.strip() for cell in next((row for _, row in rows if row), [])]
        _check_names(names)
        values, n = array("d"), len(names)
        for number, row in rows:
            try:
                plain = len(row) == n and "" not in row
                values.extend(map(float, row) if plain else _numbers(row, number, names) if row else ())
            except ValueError:
                # The cell that is no number, after numbers of its row; blanks are numbers there.
                del values[len(values) // n * n :]
                values.extend(_numbers(row, number, names))
    return dict(zip(names, np.array(values).reshape(-1, len(names)).T, strict=True))


def _check_names(names: list[str]) -> None:
    """Refuse a first line that does not name columns."""
    if not names:
        raise ArrayFileError("is empty")
    if len(names) > MAX_COLUMNS:
        raise ArrayFileError(f"has {len(names)} columns, more than {MAX_COLUMNS}")
    if any(_is_number(name) for name in names) or not all(names):
        raise ArrayFileError("the first line must name the columns, such as t,u,y")
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ArrayFileError(f"has two columns of the name {name[:100]!r}")
        seen.add(name)


def _numbers(row: list[str], number: int, names: list[str]) -> list[float]:
    if len(row) != len(names):
        raise ArrayFileError(f"line {number} has {len(row)} cells, and there are {len(names)} columns")
    try:
        return [float(cell) if cell.strip() else math.nan for cell in row]
    except ValueError:
        name, cell = next((name, cell) for name, cell in zip(names, row, strict=True) if not _is_number(cell or "0"))
        text = f"line {number}: {cell[:100]!r} in the column {name[:100]!r} is no number"
        raise ArrayFileError(text) from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
