"""The part of a traceback that lies in a user's code."""

from __future__ import annotations

import os
import re
import traceback
from pathlib import Path
from types import TracebackType

from rmpc_bench.extras import missing, missing_extra

_BENCH = f"{Path(__file__).resolve().parents[1]}{os.sep}"
_FOLDED = "  (frames of rmpc_bench left out)\n"


def user_trace(error: BaseException) -> str:
    """Return the frames of a traceback that do not belong to the bench, as Python prints them.

    Examples
    --------
    >>> try:
    ...     float("a")
    ... except ValueError as error:
    ...     text = user_trace(error)
    >>> "could not convert" in text
    True
    """
    frames = traceback.extract_tb(error.__traceback__)
    own = [not frame.filename.startswith(_BENCH) for frame in frames]
    lines: list[str] = []
    for number, frame in enumerate(frames):
        if own[number]:
            lines += traceback.format_list([frame])
        elif any(own[:number]) and own[number - 1]:
            lines.append(_FOLDED)
    extra = missing_extra(error)
    return "".join([*lines, *traceback.format_exception_only(error), *([f"{missing(extra)}\n"] if extra else [])])


def last_user_frame(error: BaseException) -> str:
    """Return file name and line of the last frame outside the bench, such as ``tanks.py:12``; empty without one."""
    frames = [each for each in traceback.extract_tb(error.__traceback__) if not each.filename.startswith(_BENCH)]
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""


def user_entry(error: BaseException) -> TracebackType | None:
    """Return the entry of a traceback at the innermost frame outside the bench; that of the error without one."""
    found, entry = error.__traceback__, error.__traceback__
    while entry is not None:
        if not entry.tb_frame.f_code.co_filename.startswith(_BENCH):
            found = entry
        entry = entry.tb_next
    return found


def place_in(trace: str) -> str:
    """Return file name and line of the last frame in the text of `user_trace`; empty without one.

    Examples
    --------
    >>> place_in('  File "tanks.py", line 12, in update')
    'tanks.py:12'
    """
    found = re.findall(r'^  File "(.+)", line (\d+)', trace, flags=re.MULTILINE)
    return f"{Path(found[-1][0]).name}:{found[-1][1]}" if found else ""


def one_line(error: BaseException) -> str:
    """Return an exception as one line, such as ``ValueError: negative level``."""
    if extra := missing_extra(error):
        return missing(extra)
    first = (str(error).strip().splitlines() or [""])[0]
    name = type(error).__name__
    return f"{name}: {first[:300]}" if first else name
