"""The table of runs as somebody else has written it: csv, csv.gz, Parquet or a data frame, read into columns.

The file is a stranger's: only a regular file of limited size is read, and its columns have limited numbers.  Nothing in
it is executed.  pandas is imported when a table is read, pyarrow for Parquet only.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench.extras import missing
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


@dataclass
class Table:
    """A table of runs; the index of its frame has the numbers of the rows in the file, which has empty lines, too."""

    name: str
    frame: pd.DataFrame
    content: bytes
    digest: str  # SHA-256 of the file
    separator: str = ""  # of a text
    notes: list[str] = field(default_factory=list)  # what was ignored, in words

    @cached_property
    def _starts(self) -> Array:
        # A cell may have line breaks in it, so that a row begins where the one before has ended.
        return np.fromiter((line for line, _ in _rows(self.content, self.separator)), dtype=np.int64)

    def lines(self, places: Iterable[int]) -> list[int]:
        """Return the lines in the file of some rows; of a table without lines the numbers of its rows, from 1 on."""
        numbers = self.frame.index[[*places]]
        return [1 + int(self._starts[number] if self.separator else number) for number in numbers]

    def problems(self, places: Sequence[int] | Array, messages: Iterable[str]) -> list[Problem]:
        """Return a problem for each of the first rows of a mistake, and the number of the others."""
        if not len(places):
            return []
        lines = self.lines(places[:MAX_NAMED])
        named = [self.problem(message, line) for line, message in zip(lines, messages, strict=False)]
        more = len(places) - len(named)
        return [*named, self.problem(f"and {more:,} more rows", lines[-1])] if more else named

    def problem(self, message: str, line: int = 0) -> Problem:
        """Return a problem of the table, or of a line of it."""
        return Problem(self.name, line, 0, "", message)

    def is_text(self, name: str) -> bool:
        """Whether a column has texts."""
        return self.frame[name].dtype.kind not in "ifb"

    def numbers(self, name: str) -> tuple[Array, Array]:
        """Return the cells of a column as floats, NaN where there is none, and the places of texts that are none."""
        import pandas as pd

        cells = self.frame[name]
        if not self.is_text(name):
            return cells.to_numpy(dtype=float, copy=True), np.empty(0, dtype=np.int64)
        texts = cells.astype(str).str.strip()
        is_missing = (cells.isna() | texts.isin(MISSING)).to_numpy()
        # A cell that is read as a number by itself is one; `1_000` is none.
        found = pd.to_numeric(texts.mask(is_missing), errors="coerce").to_numpy(dtype=float)
        words = texts.str.lower().map(WORDS).to_numpy(dtype=float)
        found = np.where(np.isnan(words), found, words)
        return found, np.flatnonzero(np.isnan(found) & ~is_missing)

    def texts(self, name: str, places: Any = slice(None)) -> Array:
        """Return cells of a column as texts, empty where there is none."""
        import pandas as pd

        codes, different = pd.factorize(self.frame[name].iloc[places], use_na_sentinel=False)
        return np.asarray(np.array([*map(_text, different.tolist())], dtype=object)[codes])


def _text(value: Any) -> str:
    """Write a cell; MATLAB and a column with gaps have whole numbers as floats."""
    if value is None or value != value:
        return ""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value).lower() if isinstance(value, bool) else str(value).strip()


def read_table(source: Any, decimal: str, separator: str, max_rows: int, is_text: Callable[[str], bool]) -> Table:
    """Read a file or a data frame; a ConfigError says what is wrong with it.

    `is_text` says of the name of a column that its cells are texts, whatever they look like.
    """
    import pandas as pd

    name, notes = str(source), list[str]()
    if isinstance(source, pd.DataFrame):
        name, frame = FRAME, source
        _check_size(name, source.columns, len(source), max_rows)
        content = packed = source.to_csv(index=False, sep=separator, decimal=decimal).encode(errors="replace")
        separator = ""
    elif not isinstance(source, str | Path):
        raise _error("", f"a table of runs is a file or a data frame of pandas (got {type(source).__name__})")
    elif wrong := wrong_line(name):
        raise _error(repr(name)[1:-1], f"the name of the file {wrong}")
    elif name.endswith(".parquet"):
        packed, content = _content(name)
        frame, separator = _parquet(content, name, max_rows, notes), ""
    elif name.endswith((".csv", ".csv.gz", ".txt", ".tsv")):
        packed, content = _content(name)
        frame = _csv(content, decimal, separator, name, max_rows, is_text)
    else:
        raise _error(name, "the ending must be .csv, .csv.gz or .parquet")
    frame = frame.set_axis(frame.columns.map(str), axis=1).reset_index(drop=True).dropna(how="all")
    if not len(frame):
        raise _error(name, "has names of columns, and no row")
    cells = {each: _cells(frame[each]) for each in frame if each and each[0] != "\0"}
    notes = ["a column without a name is ignored"] * (len(frame.columns) - len(cells)) + notes
    ignored = [each for each, column in cells.items() if column is None]
    notes += [f"column {each!r} is ignored: its cells are neither numbers nor texts" for each in ignored]
    kept = {each: column for each, column in cells.items() if column is not None}
    return Table(name, pd.DataFrame(kept, index=frame.index), content, sha256(packed).hexdigest(), separator, notes)


def _error(name: str, message: str, line: int = 0) -> ConfigError:
    return ConfigError([Problem(name, line, 0, "", message)])


def _content(name: str) -> tuple[bytes, bytes]:
    """Return the bytes of a file as they are, and unpacked."""
    try:
        content = packed = content_of(Path(name), MAX_TABLE)
        if name.endswith(".gz"):
            with gzip.GzipFile(fileobj=io.BytesIO(packed)) as file:
                content = file.read(MAX_TABLE + 1)
    except (OSError, ValueError, EOFError, zlib.error) as error:
        raise _error(name, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(content) > MAX_TABLE:
        raise _error(name, f"is unpacked larger than {MAX_TABLE / 1e6:g} MB")
    return packed, content


def _check_size(name: str, header: Iterable[Any], n_rows: int, max_rows: int) -> None:
    """Refuse too many rows and columns, and names of columns that are given twice or are not visible."""
    if n_rows > max_rows:
        raise _error(name, f"{n_rows:,} rows, at most {max_rows:,} (--max-rows)")
    counts = Counter(str(each) for each in header)
    found = [f"the column {each[:60]!r} is there {n} times" for each, n in counts.items() if each and n > 1]
    if counts.total() > MAX_COLUMNS:
        found.append(f"{counts.total():,} columns, at most {MAX_COLUMNS:,}")
    found += [f"the name of the column {each[:60]!r} {wrong}" for each in counts if (wrong := wrong_line(each))]
    if found:
        raise ConfigError([Problem(name, 1, 0, "", text) for text in found])


def _rows(content: bytes, separator: str, *, strict: bool = False) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of its last line and the cells of every row."""
    text = io.TextIOWrapper(io.BytesIO(content), "utf-8-sig", newline="")
    # pandas reads cells of any length, too; other files keep the limit of the library.
    limit = csv.field_size_limit(MAX_TABLE)
    try:
        reader = csv.reader(text, delimiter=separator, strict=strict)
        for row in reader:
            yield reader.line_num, row
    finally:
        csv.field_size_limit(limit)


def _header(content: bytes, separator: str, name: str) -> list[str]:
    """Return the names of the columns of a text, which must be UTF-8."""
    try:
        zero = content.find(0) if content.decode() else -1
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise _error(name, f"is no text in UTF-8 (byte 0x{content[error.start]:02x})", line) from None
    if zero >= 0:
        raise _error(name, "contains a zero byte", content.count(b"\n", 0, zero) + 1)
    try:
        _, first = next(_rows(content, separator, strict=True), (0, []))
    except csv.Error as error:
        raise _error(name, f"the names of the columns cannot be read ({error})", 1) from None
    header = [each.strip() for each in first]
    if not any(header):
        raise _error(name, "is empty; the first line has the names of the columns", 0 if content.strip() else 1)
    others = [sign for sign in (";", "\t", ",", "|") if sign != separator and sign in header[0]]
    if len(header) == 1 and others:
        sign = {"\t": r"$'\t'"}.get(others[0], f"'{others[0]}'")
        raise _error(name, f"the columns seem to be separated by {others[0]!r}: give --separator {sign}", 1)
    return header


def _csv(
    content: bytes, decimal: str, separator: str, name: str, max_rows: int, is_text: Callable[[str], bool]
) -> pd.DataFrame:
    """Read the rows; every number has the value that its digits have."""
    import pandas as pd

    header = _header(content, separator, name)
    _check_size(name, header, content.count(b"\n") - 1, max_rows)
    names = [each or f"\0{place}" for place, each in enumerate(header)]
    as_texts = [*filter(is_text, header)]
    # From version 4 on every number is read exactly.
    exact = {"float_precision": "round_trip"} if int(pd.__version__.partition(".")[0]) < 4 else {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(
                io.BytesIO(content), sep=separator, decimal=decimal, names=names, header=0, index_col=False,
                encoding="utf-8-sig", keep_default_na=False, dtype=dict.fromkeys(as_texts, object),
                na_values={each: MISSING for each in names if each not in as_texts},
                skip_blank_lines=False, low_memory=False, **exact,
            )  # fmt: skip
    except (ValueError, pd.errors.ParserWarning, OverflowError) as error:
        text = str(error).strip()
        if found := re.search(r"EOF inside string starting at row (\d+)", text):
            raise _error(name, "a quotation mark is not closed", int(found[1]) + 1) from None
        for line, row in _rows(content, separator) if "Expected" in text or "loss of data" in text else ():
            if len(row) > len(header):
                text = f"has {len(row)} cells, and {len(header)} columns have names"
                raise _error(name, text, line) from None
        raise _error(name, f"cannot be read as a table ({text[:200]})") from None


def _cells(column: pd.Series) -> pd.Series | None:
    """Return the cells of a column as numbers, booleans or texts; None where they are none of these."""
    from pandas.api import types as kind

    if kind.is_numeric_dtype(column) and not kind.is_complex_dtype(column):
        if kind.is_float_dtype(column) or column.isna().any():
            return column.astype("float64")
        if kind.is_bool_dtype(column):
            return column.astype(bool)
        return column.astype("int64") if column.max() < 2**63 else None
    plain = (str, int, float, bool, np.generic, type(None), type(kind.pandas_dtype("Int64").na_value))
    cells = column.astype(object)
    return cells.where(column.notna(), np.nan) if all(issubclass(each, plain) for each in {*map(type, cells)}) else None


def _parquet(content: bytes, name: str, max_rows: int, notes: list[str]) -> pd.DataFrame:
    """Read a file of Parquet; columns of lists and records are ignored."""
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError:
        raise _error(name, missing("parquet")) from None
    try:
        file = parquet.ParquetFile(pyarrow.BufferReader(content))
        meta, schema = file.metadata, file.schema_arrow
        _check_size(name, schema.names, meta.num_rows, max_rows)
        if sum(meta.row_group(number).total_byte_size for number in range(meta.num_row_groups)) > MAX_TABLE:
            raise _error(name, f"is unpacked larger than {MAX_TABLE / 1e6:g} MB")
        nested = [each.name for each in schema if pyarrow.types.is_nested(each.type)]
        frame = file.read(columns=[each for each in schema.names if each not in nested]).to_pandas(ignore_metadata=True)
    except ConfigError:
        raise
    except (pyarrow.ArrowException, OSError, ValueError, OverflowError) as error:
        raise _error(name, f"is no file of Parquet that can be read ({str(error).strip()[:200]})") from None
    notes += [f"column {each!r} is ignored: its cells are neither numbers nor texts" for each in nested]
    return frame
