"""The table of runs as somebody else has written it: csv, csv.gz, Parquet or a data frame, read into columns.

The file is a stranger's: only a regular file of limited size is read, and its columns have limited numbers.  Nothing in
it is executed.  pandas is imported when a table is read, pyarrow for Parquet only.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench.received.names import wrong_line
from rmpc_bench.received.plain_files import content_of
from rmpc_bench.types import Array, ConfigError, Problem

if TYPE_CHECKING:
    import pandas as pd

MAX_TABLE = 500_000_000
"""Largest size of a table, unpacked [bytes]."""
MAX_COLUMNS = 10_000
MAX_NAMED = 10
"""Places of one mistake that messages name."""
MISSING = ("", "NaN", "nan", "NAN", "-NaN", "-nan")
"""Cells without a number."""
WORDS = {"true": 1.0, "false": 0.0}
DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
FRAME = "table"
"""Name of a data frame in messages."""


@dataclass(frozen=True)
class Form:
    """How a text file writes its cells.

    Parameters
    ----------
    decimal : sign between whole number and fraction
    separator : sign between two cells
    """

    decimal: str = "."
    separator: str = ","


@dataclass
class Table:
    """The columns of a table, and the place of every row in its file.

    Parameters
    ----------
    name : name of the file, for messages
    header : names of all columns
    columns : column -> cells: floats, whole numbers, booleans or objects, which are texts or NaN
    rows : numbers of the rows in the file that the columns have, which leave out empty lines
    content : the bytes of the file, unpacked where it is a text
    digest : SHA-256 of the file
    form : how it writes its cells; None where it is no text
    notes : what was ignored, in words
    """

    name: str
    header: tuple[str, ...]
    columns: dict[str, Array]
    rows: Array
    content: bytes
    digest: str
    form: Form | None
    notes: list[str] = field(default_factory=list)
    _starts: Array | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def lines(self, places: Iterable[int]) -> list[int]:
        """Return the lines in the file of some rows; of a table without lines the numbers of its rows, from 1 on."""
        numbers = self.rows[[*places]]
        if self.form is None:
            return [int(number) + 1 for number in numbers]
        if self._starts is None:
            reader = _reader(self.content, self.form)
            # A cell may have line breaks in it, so that a row begins where the one before has ended.
            self._starts = np.fromiter((reader.line_num for _ in reader), dtype=np.int64) + 1
        return [int(self._starts[number]) for number in numbers]

    def problems(self, places: Sequence[int] | Array, messages: Iterable[str]) -> list[Problem]:
        """Return a problem for each of the first rows of a mistake, and the number of the others."""
        lines = self.lines(places[:MAX_NAMED])
        named = [self.problem(message, line) for line, message in zip(lines, messages, strict=False)]
        more = len(places) - len(named)
        return [*named, self.problem(f"and {more:,} more rows", lines[-1])] if more else named

    def problem(self, message: str, line: int = 0) -> Problem:
        """Return a problem of the table, or of a line of it."""
        return Problem(self.name, line, 0, "", message)

    def numbers(self, name: str) -> tuple[Array, Array]:
        """Return the cells of a column as floats, NaN where there is none, and the places of texts that are none."""
        cells = self.columns[name]
        if cells.dtype != object:
            return cells.astype(float), np.empty(0, dtype=np.int64)
        import pandas as pd

        given = pd.Series(cells)
        texts = given.astype(str).str.strip()
        # A cell that is read as a number by itself is one; `1_000` is none.
        found = pd.to_numeric(texts.where(~texts.isin(MISSING)), errors="coerce").to_numpy(dtype=float, copy=True)
        words = texts.str.lower().map(WORDS).to_numpy(dtype=float)
        found = np.where(np.isnan(words), found, words)
        wrong = np.isnan(found) & ~(given.isna() | texts.isin(MISSING)).to_numpy()
        return found, np.flatnonzero(wrong)

    def texts(self, name: str) -> Array:
        """Return the cells of a column as texts, empty where there is none."""
        cells = self.columns[name]
        if cells.dtype != object:
            return np.array([*map(_text, cells.tolist())], dtype=object)
        return np.array(["" if each is None or each != each else str(each).strip() for each in cells], dtype=object)


def _text(value: Any) -> str:
    """Write a cell of a column of numbers; MATLAB and a column with gaps have whole numbers as floats."""
    if isinstance(value, float):
        return "" if value != value else str(int(value)) if value.is_integer() else repr(value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def read_table(source: Any, form: Form, max_rows: int, is_text: Callable[[str], bool]) -> Table:
    """Read a file or a data frame; a ConfigError says what is wrong with it.

    `is_text` says of the name of a column that its cells are texts, whatever they look like.
    """
    if not isinstance(source, str | Path):
        return _of_frame(FRAME, source, b"", None, max_rows)
    path, name = Path(source), str(source)
    if wrong := wrong_line(name):
        raise _error(repr(name)[1:-1], f"the name of the file {wrong}")
    if path.suffixes[-1:] == [".parquet"]:
        return _parquet(path, name, max_rows)
    if not name.endswith((".csv", ".csv.gz", ".txt", ".tsv")):
        raise _error(name, "the ending must be .csv, .csv.gz or .parquet")
    packed = _content(path, name)
    content = _unpacked(packed, name) if name.endswith(".gz") else packed
    _check_text(content, name)
    header = _header(content, form, name)
    n_rows = content.count(b"\n") - 1
    if n_rows > max_rows:
        raise _error(name, f"{n_rows:,} rows, at most {max_rows:,} (--max-rows)")
    frame = _frame(content, form, header, name, [each for each in header if is_text(each)])
    table = _of_frame(name, frame, content, form, max_rows)
    table.header, table.digest = header, sha256(packed).hexdigest()
    return table


def _error(name: str, message: str, line: int = 0) -> ConfigError:
    return ConfigError([Problem(name, line, 0, "", message)])


def _content(path: Path, name: str) -> bytes:
    try:
        return content_of(path, MAX_TABLE)
    except (OSError, ValueError) as error:
        raise _error(name, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None


def _unpacked(packed: bytes, name: str) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(packed)) as file:
            content = file.read(MAX_TABLE + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise _error(name, f"is no gzip file ({error})") from None
    if len(content) > MAX_TABLE:
        raise _error(name, f"is unpacked larger than {MAX_TABLE / 1e6:g} MB")
    return content


def _check_text(content: bytes, name: str) -> None:
    """Refuse what is no text in UTF-8, with its line."""
    decoder, done = codecs.getincrementaldecoder("utf-8")(), 0
    view = memoryview(content)
    try:
        for done in range(0, len(content), 1 << 20):
            decoder.decode(view[done : done + (1 << 20)])
        decoder.decode(b"", final=True)
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, done + error.start) + 1
        raise _error(name, f"is no text in UTF-8 (byte 0x{error.object[error.start]:02x})", line) from None
    if (zero := content.find(b"\0")) >= 0:
        raise _error(name, "contains a zero byte", content.count(b"\n", 0, zero) + 1)


def _header(content: bytes, form: Form, name: str) -> tuple[str, ...]:
    start = io.StringIO(content[:5_000_000].decode("utf-8-sig", errors="replace"), newline="")
    try:
        found = tuple(next(csv.reader(start, delimiter=form.separator, strict=True), ()))
    except csv.Error as error:
        raise _error(name, f"the names of the columns cannot be read ({error})", 1) from None
    header = tuple(each.strip() for each in found)
    if not any(header):
        raise _error(name, "is empty; the first line has the names of the columns", 0 if content.strip() else 1)
    others = [sign for sign in (";", "\t", ",", "|") if sign != form.separator and sign in header[0]]
    if len(header) == 1 and others:
        sign = {"\t": r"$'\t'"}.get(others[0], f"'{others[0]}'")
        raise _error(name, f"the columns seem to be separated by {others[0]!r}: give --separator {sign}", 1)
    _check_header(header, name)
    return header


def _check_header(header: Sequence[str], name: str) -> None:
    counts = Counter(each for each in header if each)
    found = [f"the column {each[:60]!r} is there {n} times" for each, n in counts.items() if n > 1]
    found += [f"{len(header):,} columns, at most {MAX_COLUMNS:,}"] if len(header) > MAX_COLUMNS else []
    found += [f"the name of the column {each[:60]!r} {wrong}" for each in counts if (wrong := wrong_line(each))]
    if found:
        raise ConfigError([Problem(name, 1, 0, "", text) for text in found])


def _frame(content: bytes, form: Form, header: Sequence[str], name: str, as_texts: Sequence[str]) -> pd.DataFrame:
    """Read the rows; every number has the value that its digits have."""
    import warnings

    import pandas as pd

    names = [each or f"\0{place}" for place, each in enumerate(header)]
    # From version 4 on every number is read exactly.
    exact = {"float_precision": "round_trip"} if int(pd.__version__.partition(".")[0]) < 4 else {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(
                io.BytesIO(content), sep=form.separator, decimal=form.decimal, names=names, header=0, index_col=False,
                encoding="utf-8-sig", keep_default_na=False, dtype=dict.fromkeys(as_texts, object),
                na_values={each: MISSING for each in names if each not in as_texts},
                skip_blank_lines=False, low_memory=False, **exact,
            )  # fmt: skip
    except (ValueError, pd.errors.ParserWarning, OverflowError) as error:
        text = str(error).strip()
        if found := re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", text):
            raise _error(name, f"has {found[3]} cells, and {found[1]} columns have names", int(found[2])) from None
        if "loss of data" in text:
            raise _longer_row(content, form, len(header), name) from None
        if found := re.search(r"EOF inside string starting at row (\d+)", text):
            raise _error(name, "a quotation mark is not closed", int(found[1]) + 1) from None
        raise _error(name, f"cannot be read as a table ({text[:200]})") from None


def _reader(content: bytes, form: Form) -> Any:
    # pandas reads cells of any length, too.
    csv.field_size_limit(MAX_TABLE)
    return csv.reader(io.TextIOWrapper(io.BytesIO(content), "utf-8-sig", newline=""), delimiter=form.separator)


def _longer_row(content: bytes, form: Form, width: int, name: str) -> ConfigError:
    reader = _reader(content, form)
    n, line = next(((len(row), reader.line_num) for row in reader if len(row) > width), (width + 1, 2))
    return _error(name, f"has {n} cells, and {width} columns have names", line)


def _of_frame(name: str, frame: Any, content: bytes, form: Form | None, max_rows: int) -> Table:
    """Return a data frame as a table, without rows that are wholly empty."""
    import pandas as pd

    if not isinstance(frame, pd.DataFrame):
        raise _error("", f"a table of runs is a file or a data frame of pandas (got {type(frame).__name__})")
    if len(frame) > max_rows:
        raise _error(name, f"{len(frame):,} rows, at most {max_rows:,} (--max-rows)")
    header = tuple(str(each) for each in frame.columns)
    if form is None:
        _check_header(header, name)
        # The cells of a frame, whatever it is made of.
        digest = sha256(pd.util.hash_pandas_object(frame.astype(str), index=False).to_numpy().tobytes())
        content = content or digest.digest()
    empty = frame.isna().all(axis=1).to_numpy() if len(frame.columns) else np.zeros(0, dtype=bool)
    rows = np.flatnonzero(~empty)
    if not len(rows):
        raise _error(name, "has names of columns, and no row")
    frame = frame if len(rows) == len(frame) else frame.iloc[rows]
    columns, notes = dict[str, Array](), list[str]()
    for place, each in enumerate(header):
        cells = _cells(frame.iloc[:, place])
        if each.startswith("\0") or not each:
            notes.append("a column without a name is ignored")
        elif cells is None:
            notes.append(f"column {each!r} is ignored: its cells are neither numbers nor texts")
        else:
            columns[each] = cells
    return Table(name, header, columns, rows, content, sha256(content).hexdigest(), form, notes)


def _cells(column: Any) -> Array | None:
    """Return the cells of a column as numbers, booleans or texts; None where they are none of these."""
    import pandas as pd

    kind = pd.api.types
    if kind.is_bool_dtype(column) and not column.isna().any():
        return np.asarray(column, dtype=bool)
    if kind.is_integer_dtype(column) and not column.isna().any():
        return np.asarray(column, dtype=np.int64) if column.max() < 2**63 else None
    if kind.is_numeric_dtype(column) and not kind.is_complex_dtype(column):
        return np.asarray(column.astype("float64"), dtype=float)
    cells = np.asarray(column.astype(object), dtype=object)
    plain = (str, int, float, bool, np.generic, type(None), type(pd.NA))
    return np.where(column.isna(), np.nan, cells) if all(isinstance(each, plain) for each in cells) else None


def _parquet(path: Path, name: str, max_rows: int) -> Table:
    """Read a file of Parquet; columns of lists and records are ignored."""
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError:
        raise _error(name, "needs the library pyarrow; in a clone, pip install '.[parquet]' installs it") from None
    content = _content(path, name)
    try:
        file = parquet.ParquetFile(pyarrow.BufferReader(content))
        meta, schema = file.metadata, file.schema_arrow
        if meta.num_rows > max_rows:
            raise _error(name, f"{meta.num_rows:,} rows, at most {max_rows:,} (--max-rows)")
        _check_header(schema.names, name)
        size = sum(meta.row_group(number).total_byte_size for number in range(meta.num_row_groups))
        if size > MAX_TABLE:
            raise _error(name, f"is unpacked larger than {MAX_TABLE / 1e6:g} MB")
        nested = [each.name for each in schema if pyarrow.types.is_nested(each.type)]
        frame = file.read(columns=[each for each in schema.names if each not in nested]).to_pandas(ignore_metadata=True)
    except (pyarrow.ArrowException, OSError, ValueError, OverflowError) as error:
        if isinstance(error, ConfigError):
            raise
        raise _error(name, f"is no file of Parquet that can be read ({str(error).strip()[:200]})") from None
    table = _of_frame(name, frame, content, None, max_rows)
    table.notes += [f"column {each!r} is ignored: its cells are neither numbers nor texts" for each in nested]
    return table
