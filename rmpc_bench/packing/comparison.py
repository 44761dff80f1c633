"""Two versions of one file or of its rows: equal in bytes, equal up to rounding, or the first place of a difference."""

from __future__ import annotations

import re
import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest
from math import isfinite, isnan
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.received.arrays import check_width, matrices
from rmpc_bench.types import Array, Status

BYTES = "compared, equal bytes"
NUMBERS = "compared, equal to 1e-9"
HASHED = "only hashed"
UNSEEN = "not looked at"
DIFFERENT = "different"
TOLERANCE = 1e-9  # largest relative difference of equal values on two machines
_TEXT = ("method", "metric", "status", "quantity", "component", "phase", "worst_step")
_DIGITS = 5.1e-6  # largest relative difference of two numbers with equal six digits, one of them unrounded
_COUNTS = ("run", "k", "n", "calls", "held_steps", "failed_steps")
_NUMBER = re.compile(r"([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)")
_LENGTH = re.compile(rb"(/Length |\bobj\n)(\d{1,12})(?= /| >>|\nendobj)")
"""Where a PDF file states how long a stream is, before or after it."""
_PLACE = re.compile(rb"(\n|startxref\n)(\d{1,12})(?= \d{5} [nf] \n|\n%%EOF)")
"""Where a PDF file states at which byte an object begins."""
_FONT_PLACE = re.compile(rb"/(?:FontFile2|CIDToGIDMap) (\d{1,12}) 0 R")
"""Where a PDF file names the object with the outlines of a font, or with its order of glyphs."""
_OBJECT = re.compile(r"\n(\d{1,12}) 0 obj\n[^\n]*\nstream\n$")
_FONT_LENGTH = re.compile(r"(/Length1 )\d{1,12}")
_MOST_BYTES = 100_000_000  # length of a stream of a PDF file that is read
_SHOWN = 50  # characters of a difference that are shown


def read_rows(path: Path, most: int = 1_000_000, first: str = "method") -> pd.DataFrame:
    """Read a table: texts and the columns of a sweep, before `first`, as they are, every float as it was written."""
    check_width(path)
    table = pd.read_csv(path, dtype=str, keep_default_na=False, encoding="utf-8", nrows=most + 1)
    if len(table) > most:
        raise ValueError(f"has more than {most} rows")
    texts = {*_TEXT, *table.columns[: list(table.columns).index(first)]}
    kinds = {name: np.int64 if name in _COUNTS else np.float64 for name in table if name not in texts}
    # Python reads every float as it was written; the readers of pandas differ between its versions.
    numbers = {name: np.array([float(text or "nan") for text in table[name]]) for name in kinds}
    return table.assign(**{name: values.astype(kinds[name]) for name, values in numbers.items()})


def wrong_row(rows: pd.DataFrame, points: Sequence[tuple[Mapping[str, str], Collection[str]]], n_runs: int) -> str:
    """Name the first row of no trial of these points with their methods, or of one that has a row; empty for none."""
    paths = [*dict.fromkeys(path for point, _ in points for path in point)]
    if [*rows.columns[: len(paths) + 1]] != [*paths, "method"]:
        return f"the first columns must be {', '.join([*paths, 'method'])}"
    known = np.zeros(len(rows), dtype=bool)
    for point, methods in points:
        known |= _at(rows, point) & rows["method"].isin(methods).to_numpy()
    known &= rows["run"].between(0, n_runs - 1).to_numpy() & rows["status"].isin([each.word for each in Status])
    twice = rows.duplicated([*paths, "method", "run"]).to_numpy()
    for number in np.flatnonzero(~known | twice)[:1]:
        return f"row {number + 1}: " + ("is given twice" if known[number] else "is of no trial of the configuration")
    return ""


def with_rows(trials: Trials, rows: pd.DataFrame) -> Trials:
    """Return a table of trials with other rows, such as the packed ones; methods without a row are left out."""
    if trials.points:
        parts = [rows[_at(rows, table.point)] for table in trials.points]
        points = tuple(with_rows(*each) for each in zip(trials.points, parts, strict=True))
        return replace(trials, points=points, columns=_columns(pd.concat(parts), trials))
    present = {*rows["method"]}
    methods = tuple(name for name in trials.methods if name in present) if len(trials.runs) else trials.methods
    metrics = tuple(info for info in trials.metrics if info.name in rows.columns)
    order = {name: number for number, name in enumerate(methods)}
    rows = rows[rows["method"].isin(methods)]
    rows = rows.iloc[np.lexsort((rows["run"], rows["method"].map(order)))]
    return replace(trials, methods=methods, metrics=metrics, columns=_columns(rows, trials))


def with_draws(trials: Trials, rows: pd.DataFrame) -> Trials:
    """Return a table of trials with the packed values of the uncertain quantities of further runs."""
    if trials.points:
        return replace(trials, points=tuple(with_draws(each, rows[_at(rows, each.point)]) for each in trials.points))
    own = trials.quantities
    if not len(trials.runs) or not {*own} <= {*rows}:
        return trials
    more = rows[rows["run"].isin({*trials.runs} - {*own["run"]})].drop_duplicates("run").sort_values("run")
    drawn = {name: np.concatenate([values, more[name].to_numpy()]) for name, values in own.items()}
    return replace(trials, quantities=drawn) if {*trials.runs} <= {*drawn["run"]} else trials


def _at(rows: pd.DataFrame, point: Mapping[str, str]) -> Array:
    found: Array = np.ones(len(rows), dtype=bool)
    for path, value in point.items():
        found &= (rows[path] == value).to_numpy() if path in rows else False
    return found


def _columns(rows: pd.DataFrame, trials: Trials) -> dict[str, Array]:
    """Return the columns that a table of trials has, too."""
    return {name: np.asarray(rows[name]) for name in trials.columns if name in rows}


def rows_against_summary(rows: pd.DataFrame, summary: pd.DataFrame) -> list[str]:
    """Compute the numbers of summary.csv again from the packed rows, and name those that do not follow."""
    if len(rows) and not len(summary):
        return ["summary.csv has no line"]
    paths = [name for name in summary.columns[: list(summary.columns).index("method")] if name in rows]
    rows = _common(rows, paths)
    return [
        f"{' '.join(str(line[name]) for name in [*paths, 'method', 'metric'])} {what}: "
        f"summary.csv {stated:g}, its rows {found:.6g}"
        for _, line in summary.iterrows()
        for what, stated, found in _against_rows(rows, line, paths)
    ]


def _common(rows: pd.DataFrame, paths: Sequence[str]) -> pd.DataFrame:
    """Leave out the runs that not every method of a point has; summary.csv rests on the others."""
    n_methods = rows.groupby(paths)["method"].transform("nunique") if paths else rows["method"].nunique()
    return rows[rows.groupby([*paths, "run"])["method"].transform("nunique") == n_methods]


def _against_rows(rows: pd.DataFrame, line: pd.Series, paths: Sequence[str]) -> Iterator[tuple[str, float, float]]:
    """Yield what differs in a line of summary.csv: what it is, the stated number, and that of the rows."""
    chosen = rows["method"] == line["method"]
    for path in paths:
        chosen &= rows[path] == line[path]
    if line["metric"] not in rows:
        yield "column", 1.0, 0.0
        return
    column = rows.loc[chosen, line["metric"]].dropna().to_numpy(dtype=float)
    finite = column[np.isfinite(column)]
    scale = float(np.max(np.abs(finite), initial=0.0))
    computed = {"n": float(len(column)), "n_failed": float(chosen.sum() - len(column))}
    if len(column):
        with np.errstate(invalid="ignore"):
            numbers = {"mean": np.mean(column), "median": np.median(column), "min": column.min(), "max": column.max()}
        computed |= {name: float(value) for name, value in numbers.items()}
    for what, found in computed.items():
        stated = float(line[what])
        # The mean of what may not occur is not stated.
        same = stated == found or (isnan(stated) and (what == "mean" or not isfinite(found)))
        same |= isfinite(found) and abs(stated - found) <= _DIGITS * abs(found) + TOLERANCE * scale
        if not same:
            yield what, stated, found


class FileOutcome(NamedTuple):
    """What was found about a file of an archive."""

    name: str
    # `BYTES`, `NUMBERS`, `HASHED`, `UNSEEN`, `DIFFERENT`, or by what it was made where that is why it has no other
    word: str
    note: str = ""  # the first difference, or why it was not compared

    def __str__(self) -> str:
        return f"{self.word}: {self.note}" if self.note else self.word

    @property
    def is_compared(self) -> bool:
        """Whether it is equal to a file that was made again."""
        return self.word in (BYTES, NUMBERS)

    @property
    def is_different(self) -> bool:
        """Whether it differs from what it should be."""
        return self.word == DIFFERENT


def compared(name: str, packed: Path, here: Path, *, exact: bool) -> FileOutcome:
    """Compare a file with the one that was made again; `exact` where nothing but equal bytes is equal."""
    if packed.stat().st_size > _allowed(here.stat().st_size):
        return FileOutcome(name, DIFFERENT, f"has {packed.stat().st_size} bytes, here {here.stat().st_size}")
    a, b = packed.read_bytes(), here.read_bytes()
    if a == b:
        return FileOutcome(name, BYTES)
    try:
        found = _first_difference(a, b) if exact else _other_value(name, packed, here)
    except (ValueError, KeyError, OSError, EOFError, MemoryError, zlib.error) as error:
        found = f"cannot be read ({error})"
    return FileOutcome(name, DIFFERENT, found) if found else FileOutcome(name, NUMBERS)


def _allowed(size: int) -> int:
    """Return the largest size of what may be equal to something of this size."""
    return 4 * size + 100_000


def compared_text(name: str, packed: str, here: str, *, exact: bool = True) -> FileOutcome:
    """Compare a text of an archive with the one that was made again."""
    if packed == here:
        return FileOutcome(name, BYTES)
    found = _first_difference(packed.encode(), here.encode()) if exact else _other_text(packed, here)
    return FileOutcome(name, DIFFERENT, found) if found else FileOutcome(name, NUMBERS)


def _first_difference(a: bytes, b: bytes) -> str:
    """Name the first place at which two contents differ."""
    place = next((i for i, (one, other) in enumerate(zip(a, b, strict=False)) if one != other), min(len(a), len(b)))
    try:
        a.decode(), b.decode()
    except UnicodeDecodeError:
        return f"byte {place + 1} of {len(a)} differs"
    start = max(a.rfind(b"\n", 0, place) + 1, place - _SHOWN // 2)
    shown = (ascii(each[start : start + _SHOWN].partition(b"\n")[0].decode(errors="replace")) for each in (a, b))
    line = a[:place].count(b"\n") + 1
    return f"line {line}: packed {next(shown)}, here {next(shown)}"


def _other_value(name: str, packed: Path, here: Path) -> str:
    """Name the first value that differs by more than the tolerance; empty where none does."""
    if name.endswith(".npz"):
        return _other_array(packed, here)
    if name == "series.csv":
        return _other_series(read_rows(packed), read_rows(here))
    a, b = packed.read_bytes(), here.read_bytes()
    if name.endswith(".pdf"):
        pairs = zip_longest(_parts(a), _parts(b), fillvalue="")
        return next(filter(None, (_other_text(one, other) for one, other in pairs)), "")
    return _other_text(a.decode(), b.decode())


def _other_text(a: str, b: str) -> str:
    """Compare two texts: words as they are, whole numbers exactly, other numbers up to the tolerance."""
    line = 1
    if len(a) > _allowed(len(b)):
        return f"has {len(a)} characters, here {len(b)}"
    for one, other in zip_longest(_NUMBER.split(a), _NUMBER.split(b), fillvalue=""):
        if not _same(one, other):
            return f"line {line}: packed {ascii(one[:_SHOWN])}, here {ascii(other[:_SHOWN])}"
        line += one.count("\n")
    return ""


def _same(one: str, other: str) -> bool:
    if one == other:
        return True
    if not (_NUMBER.fullmatch(one) and _NUMBER.fullmatch(other)) or {*one, *other} <= {*"+-0123456789"}:
        return False
    x, y = float(one), float(other)
    # The difference of a finite number to an infinite one, such as 1e999, is no number to compare.
    return isfinite(x) and isfinite(y) and abs(x - y) <= TOLERANCE * max(abs(x), abs(y))


def _parts(content: bytes) -> Iterator[str]:
    """Yield what is outside and inside of the streams of a PDF file, with what stands at a place for its number."""
    place, before = 0, 0
    while (start := content.find(b"stream\n", place) + 7) > 6 and (end := content.find(b"\nendstream", start)) > 0:
        yield _placed(content, place, start, (before, end - start))
        yield _unpacked(content[start:end])
        place, before = end + len("\nendstream"), end - start
    yield _placed(content, place, len(content), (before, 0))


def same_but_fonts(packed: Path, here: Path) -> bool:
    """Whether two PDF files differ in the embedded fonts only, which follow from the version of the library."""
    if packed.stat().st_size > _allowed(here.stat().st_size):
        return False
    a, b = (list(_without_fonts(path.read_bytes())) for path in (packed, here))
    return len(a) == len(b) and not any(_other_text(one, other) for one, other in zip(a, b, strict=True))


def _without_fonts(content: bytes) -> Iterator[str]:
    fonts, in_font = {int(place) for place in _FONT_PLACE.findall(content)}, False
    for number, part in enumerate(_parts(content)):
        if number % 2:  # a stream
            yield "" if in_font else part
            continue
        found = _OBJECT.search(part)
        in_font = found is not None and int(found[1]) in fonts
        yield _FONT_LENGTH.sub(r"\1", part)


def _placed(content: bytes, start: int, stop: int, sizes: tuple[int, int]) -> str:
    """Return a part of a PDF file: a length is that of the next or the last stream or not, a place is its object."""

    def size(found: re.Match[bytes]) -> bytes:
        is_right = int(found[2]) == sizes[found[1] == b"/Length "]
        return found[1] + (b"right" if is_right else found[2])

    text = _LENGTH.sub(size, content[start:stop])
    return _PLACE.sub(lambda found: found[1] + content[int(found[2]) : int(found[2]) + 8], text).decode("latin-1")


def _unpacked(stream: bytes) -> str:
    """Return the content of a stream of a PDF file, as it is where it is not compressed or something follows it."""
    reader = zlib.decompressobj()
    try:
        found = reader.decompress(stream, _MOST_BYTES)
    except zlib.error:
        return stream.decode("latin-1")
    return (found if reader.eof and not reader.unused_data else stream).decode("latin-1")


def _other_series(packed: pd.DataFrame, here: pd.DataFrame) -> str:
    """Compare two tables of series, each value up to the tolerance of the largest of its quantity."""
    keys = [name for name in here.columns if name != "value"]
    if [*packed.columns] != [*here.columns] or not packed[keys].equals(here[keys]):
        return "has other rows or columns"
    groups = [here[name] for name in keys if name not in ("component", "k", "n")]
    scale = here["value"].abs().where(np.isfinite(here["value"])).groupby(groups).transform("max").to_numpy()
    wrong = _wrong(packed["value"].to_numpy(), here["value"].to_numpy(), scale)
    if not len(wrong):
        return ""
    one, other = packed.iloc[wrong[0, 0]], here.iloc[wrong[0, 0]]
    return f"{' '.join(str(one[name]) for name in keys)}: packed {one['value']!r}, here {other['value']!r}"


def _other_array(packed: Path, here: Path) -> str:
    """Compare the arrays of two files, each number up to the tolerance of the largest of its array."""
    a, b = (matrices(file.read_bytes(), ".npz", "") for file in (packed, here))
    if [*a] != [*b]:
        return "has other arrays"
    for name, other in b.items():
        one = a[name]
        if one.shape != other.shape or one.dtype != other.dtype:
            return f"array {ascii(name)}: another shape or type"
        is_whole = other.dtype.kind != "f"
        wrong = _wrong(one, other, 0.0 if is_whole else np.max(np.abs(other[np.isfinite(other)]), initial=0.0))
        if len(wrong):
            first = tuple(wrong[0])
            return f"array {ascii(name)} at {first}: packed {one[first]!r}, here {other[first]!r}"
    return ""


def _wrong(one: Array, other: Array, scale: Array | float) -> Array:
    """Return the indices of what differs by more than the tolerance of a scale."""
    with np.errstate(invalid="ignore"):
        same = (one == other) | ((one != one) & (other != other))
        found: Array = np.argwhere(~(same | (np.abs(one - other) <= TOLERANCE * scale)))
    return found
