"""Content of a file that is named by a user or lies in a directory of somebody else, and of JSON in it.

A pipe without a writer would never end, and a device such as /dev/zero has no end: only regular files of limited size
are read.  JSON is checked for its nesting, names that are given twice, and the type and range of every field that is
used.  This module imports no NumPy, since `run` with nothing to do needs none.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

from rmpc_bench.received.names import HIDDEN, text_of_form, wrong_formula, wrong_line, wrong_text


def wrong_time(text: object) -> str:
    """Say what is wrong with a time of day; empty where nothing is."""
    try:
        good = isinstance(text, str) and datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        good = False
    return "" if good else "must be a time with its zone, such as 2026-01-31T12:00:00+00:00"


def wrong_message(value: Any) -> str:
    """Say what is wrong with what another program has said, in any characters; empty where nothing is."""
    return "" if isinstance(value, str) else "must be text"


_WITH_WORD = ("-s", "--only", "--add-method")
_OF_IMPORT = {f"--{name}" for name in "columns wide decimal separator missing keep-last".split()}
_OPTION = re.compile(rf"--smoke|--runs [0-9]{{1,15}}|(?:{'|'.join(_WITH_WORD)}) (.+)", re.DOTALL)


def wrong_option(value: Any) -> str:
    """Say what is wrong with an option of `run` that changes an experiment; empty where nothing is."""
    found = _OPTION.fullmatch(str(value))
    given = found[1] or "x" if found else ""
    try:
        # What follows is one word for a shell.
        good = isinstance(value, str) and not wrong_text(value) and [*map(shlex.quote, shlex.split(given))] == [given]
    except ValueError:
        good = False
    return "" if good else "must be an option that changes an experiment, such as --runs 4 or -s 'seed=2'"


def wrong_command(value: Any) -> str:
    """Say what is wrong with the command that a page recommends; empty where nothing is."""
    start, verb, rest = str(value).partition(" import " if str(value).startswith("rmpc-bench import ") else " run ")
    try:
        words = shlex.split(rest) if isinstance(value, str) and not wrong_line(value) else []
    except ValueError:
        words = []
    # For a shell every word is one, and none is an option that names code or a place.
    good = start == "rmpc-bench" and words and " ".join(map(shlex.quote, words)) == rest
    known = _OF_IMPORT if verb == " import " else {"--smoke", "--runs", *_WITH_WORD}
    options = {word for word in words if word.startswith("-")} - known
    return "" if good and not options else "must be `rmpc-bench run` with a file and options that change an experiment"


def wrong_size(value: Any) -> str:
    """Say what is wrong with a number that is not negative; empty where nothing is."""
    return "" if type(value) in (int, float) and 0 <= value < 1e308 else "must be a number that is not negative"


def wrong_span(value: Any) -> str:
    """Say what is wrong with a range of runs; empty where nothing is."""
    good = isinstance(value, list) and len(value) == 2 and all(type(each) is int for each in value)
    good = good and 0 <= value[0] <= value[1] < 2**53
    return "" if good else "must be two whole numbers, the first run and the last one"


wrong_commit = text_of_form("[0-9a-f]{40}|[0-9a-f]{64}|unknown", "must have 40 hexadecimal digits, or be 'unknown'")
MAX_BYTES = 10_000_000  # largest size of a file of a configuration or of an experiment's record [bytes]
MAX_DEPTH = 60  # levels of lists and objects of a JSON text
COUNT = range(2**53)  # numbers of runs, steps and calls
_SUSPECT = re.compile(
    rb"\\[bfu]|[\x00-\x08\x0b-\x1f\x7f]|\xc2[\x80-\x9f]|\xd8\x9c|\xe2\x80[\x8e\x8f\xaa-\xae]|\xe2\x81[\xa6-\xa9]"
)  # where a JSON text may have characters that a name must not contain
_NO_BRACKETS = bytes(each for each in range(256) if each not in b"[]{}")
_WORDS = {int: "a whole number", bool: "true or false", list: "a list", dict: "an object", type(None): "null"}
MANIFEST: Any = {
    "name?": wrong_line,
    "experiment?": wrong_line,
    "seed?": range(2**63),
    "modified?": [wrong_option],
    "versions?": {wrong_line: wrong_line},
    "libraries?": {wrong_line: wrong_line},
    "numerics?": COUNT,
    "blas?": [{wrong_line: (int, None, wrong_line)}],
    "git?": (None, {"commit": wrong_commit, "dirty?": bool}),
    "platform?": {"system?": wrong_line, "machine?": wrong_line, "cores?": (COUNT, None)},
    "file?": wrong_line,
    "looks?": [(COUNT, wrong_line)],
    "report?": {
        **{"place?": wrong_line, "file?": wrong_line, "keys?": dict, "labels?": {wrong_line: str}},
        **{"own_figures?": bool, "matplotlib?": wrong_line},
    },
    "files?": {str: str},
    "origin?": wrong_line,
    "warnings?": [wrong_line],
    "sources?": [{"file": wrong_line, "copy": wrong_line, "sha256": wrong_line, "rows": COUNT, "options": dict}],
    "sessions?": [{"start": wrong_time, "stop": (wrong_time, None), "why": wrong_line, "shard?": wrong_line}],
}
_MEAN: Any = {**dict.fromkeys(("point", "method"), wrong_line), **dict.fromkeys(("n", "n_other"), COUNT)}
_MEAN |= {"mean": (float, None), "m2": (wrong_size, None)}
PROGRESS: Any = {
    **dict.fromkeys(("name", "metric", "state", "why", "host"), wrong_line),
    "pid": range(2**31),
    "updated": wrong_time,
    "every": wrong_size,
    "runs": wrong_span,
    "n_runs": range(1, 2**53),
    "total": COUNT,
    "done": COUNT,
    "all_trials": COUNT,
    "failed": {wrong_line: COUNT},
    "rate": wrong_size,
    "left_seconds": (wrong_size, None),
    "shard?": (wrong_line, None),
    "stage?": wrong_line,
    "means?": [_MEAN],
}
TUNING: Any = {"version": int, "searches": {str: dict}}
SECONDS: Any = {str: wrong_size}
_CLAIM = {"id": (str, None), "statement": str, "source": str, "kind": str, "joined": str, "words?": str}
_TEXTS = {"name": str, "title": str, "command": wrong_command}
CLAIMS: Any = {"experiment": {**_TEXTS, "paper?": (str, None), "runs": COUNT, "final": bool}, "claims": [_CLAIM]}
_CODE = {"numerics": COUNT, **dict.fromkeys(("sources?", "installed?", "data?"), {str: [str]})}
STORED: dict[str, Any] = {
    "libraries": {str: {str: [str]}},
    "shared": dict,
    "files": {str: {str: str}},
    "looks": {"runs?": [(COUNT, wrong_line)]},
    "stop": {"key?": str, "runs?": [range(10**7 + 1)], "wanted?": range(10**7 + 1), "is_met?": bool, "open?": [str]},
    "layout": dict,
    "methods.code": _CODE,
    "durations.counts": [[range(-10_000, 2**53)]],
    "failures.failure": {
        "run": COUNT,
        "status": range(128),
        "component": str,
        "k": (COUNT, None),
        "message": wrong_message,
        "trace?": wrong_message,
        "values?": dict,
    },
}  # JSON texts in a trial store: those of its table `meta` by their key, and others by their column
_NOTES: ContextVar[dict[str, str] | None] = ContextVar("_NOTES", default=None)


@contextmanager
def noted() -> Iterator[dict[str, str]]:
    """Yield path -> SHA-256 of the files that are read in the block; empty for one that is not there."""
    notes: dict[str, str] = {}
    token = _NOTES.set(notes)
    try:
        yield notes
    finally:
        _NOTES.reset(token)


def note_absent(path: Path) -> None:
    """Note that a file is not there, where another is read in its place."""
    notes = _NOTES.get()
    if notes is not None:
        notes[os.path.abspath(path)] = ""


def content_of(path: str | Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Read a regular file; `OSError` where it cannot be read, is not a regular file or is larger."""
    # Without O_NONBLOCK, opening a pipe waits for a writer.
    number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    mode = os.fstat(number).st_mode
    if stat.S_ISDIR(mode):
        os.close(number)
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    with open(number, "rb") as file:
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "is not a regular file", str(path))
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise OSError(errno.EFBIG, f"is larger than {max_bytes / 1e6:g} MB", str(path))
    notes = _NOTES.get()
    if notes is not None:
        notes[os.path.abspath(path)] = sha256(content).hexdigest()
    return content


def text_of(path: str | Path, max_bytes: int = MAX_BYTES) -> str:
    """Read a regular file as UTF-8; see `content_of`."""
    return content_of(path, max_bytes).decode("utf-8")


class StoreError(Exception):
    """A directory that cannot be used: it holds another experiment, or another process writes to it."""


class DamagedError(StoreError):
    """A stored or received file that does not have the form in which this program writes it."""


def json_of(path: Path, shape: Any, way_out: str, max_bytes: int = MAX_BYTES) -> Any:
    """Read a JSON file and check it, see `checked`; None where there is no such file."""
    try:
        content = content_of(path, max_bytes)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise DamagedError(f"{path}: {error.strerror}; {way_out}") from None
    try:
        return checked(content, shape)
    except ValueError as error:
        raise DamagedError(f"{path}: {error}; {way_out}") from None


def checked(content: bytes, shape: Any, *, any_text: bool = False) -> Any:
    """Return the value of a JSON text; `ValueError` with the field where it does not have its shape.

    A shape is `int`, `float`, `str`, `bool`, `list`, `dict` or None; a range of integers; a function that says what is
    wrong; ``[shape]`` for a list; ``{str: shape}`` for a mapping, where a function may stand for `str`;
    ``{name: shape}`` for an object with these entries, optional where the name ends with ``?``, and any others; a tuple
    of shapes, one of which it has.  With `any_text` texts may have control characters, as messages of other programs.
    """
    _check_nesting(content)
    try:
        value = json.loads(content.decode("utf-8"), object_pairs_hook=_unique)
    except UnicodeError:
        raise ValueError("is not a text in UTF-8") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"is not JSON ({error})") from None
    except ValueError as error:
        raise ValueError(str(error).partition(";")[0]) from None
    if not any_text and (b"$" in content or _SUSPECT.search(content)):
        _check_texts(value, "")
    _check(value, shape, "")
    return value


def _check_nesting(content: bytes) -> None:
    """Refuse lists in lists without end, and more of them than have room in memory."""
    rest = content.translate(None, _NO_BRACKETS)
    if len(rest) > 2 * (len(content) // 5 + 10_000):
        raise ValueError("has too many lists and objects for its size")
    if _is_deep(rest):
        # Brackets in texts do not count.
        rest = re.sub(rb'"(?:[^"\\]|\\.)*+"', b"", content, flags=re.DOTALL).translate(None, _NO_BRACKETS)
        if _is_deep(rest):
            raise ValueError(f"is nested more than {MAX_DEPTH} levels deep, or ends too early")


def _is_deep(brackets: bytes) -> bool:
    for _ in range(MAX_DEPTH):
        before, brackets = brackets, brackets.replace(b"[]", b"").replace(b"{}", b"")
        if len(before) == len(brackets):
            break
    return bool(brackets)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object; a name that is given twice would hide one of its values."""
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))  # type: ignore[func-returns-value]
        raise ValueError(f"the entry {twice[:60]!r} is given twice")
    return found


def _check_texts(value: Any, field: str) -> None:
    """Refuse control and direction characters, and formulas nested too deep, in any text."""
    if isinstance(value, str):
        if HIDDEN.search(value) or wrong_formula(value):
            raise ValueError(f"{field or 'the file'}: {wrong_text(value)}")
    elif isinstance(value, dict):
        for name, each in value.items():
            _check_texts(name, f"{field}.{name[:60]!r}".lstrip("."))
            _check_texts(each, f"{field}.{name}".lstrip("."))
    elif isinstance(value, list):
        for number, each in enumerate(value):
            _check_texts(each, f"{field}[{number}]")


def _check(value: Any, shape: Any, field: str) -> None:
    """Raise `ValueError` with the field that does not have its shape."""
    if isinstance(shape, tuple):
        for each in shape[:-1]:
            try:
                return _check(value, each, field)
            except ValueError:
                continue
        return _check(value, shape[-1], field)
    if isinstance(shape, list | dict) and isinstance(value, type(shape)):
        return _check_entries(value, shape, field)
    wrong = _wrong(value, shape)
    if wrong:
        huge = isinstance(value, list | dict) and len(value) > 10 or isinstance(value, int) and abs(value) > 2**64
        text = f"a long {type(value).__name__}" if huge else repr(value)
        raise ValueError(f"{field or 'the file'}: {wrong} (got {text[:60]}{'...' if len(text) > 60 else ''})")
    return None


def _check_entries(value: Any, shape: Any, field: str) -> None:
    if isinstance(shape, list):
        for number, each in enumerate(value):
            _check(each, shape[0], f"{field}[{number}]")
    elif callable(rule := next(iter(shape))):
        for name, each in value.items():
            _check(name, rule, f"{field}: the name")
            _check(each, shape[rule], f"{field}.{name}".lstrip("."))
    else:
        for key, each in shape.items():
            name = key.rstrip("?")
            if name in value:
                _check(value[name], each, f"{field}.{name}".lstrip("."))
            elif name == key:
                raise ValueError(f"{field or 'the file'}: the entry {name!r} is missing")


def _wrong(value: Any, shape: Any) -> str:
    """Say what is wrong with a single value; empty where nothing is."""
    if isinstance(shape, range):
        good = type(value) is int and value in shape
        return "" if good else f"must be a whole number from {shape.start} to {shape.stop - 1}"
    if shape is float:
        good = type(value) in (int, float) and -1e308 < value < 1e308
        return "" if good else "must be a number"
    if shape is str:
        return wrong_text(value)
    if shape is None or isinstance(shape, type | list | dict):
        kind = type(None) if shape is None else shape if isinstance(shape, type) else type(shape)
        return "" if type(value) is kind else f"must be {_WORDS[kind]}"
    return str(shape(value))
