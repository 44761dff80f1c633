"""Standard streams of the program: one that is closed, or that no process reads, is no error.

Much of what is written comes from files, so the characters that a terminal obeys are written as escapes, here only.

With a closed descriptor the next file that is opened, such as the trial store, would get its number and receive the
messages.  A reader that ends early (``| head``) or a lost terminal must not end a computation either.
"""

from __future__ import annotations

import codecs
import io
import os
import shutil
import sys
from collections.abc import Sequence
from typing import Any

import click

WIDTHS = (40, 80)  # fewest and most columns for which texts are laid out


def screen_width() -> int:
    """Return the columns of the terminal, at most 80; that of COLUMNS where it is given."""
    low, high = WIDTHS
    return min(high, max(low, shutil.get_terminal_size((high, 24)).columns))


def echo_folded(lines: Sequence[str]) -> None:
    """Print lines, broken where the terminal ends."""
    # Only now: `types` imports NumPy.
    from rmpc_bench.types.texts import folded

    click.echo("\n".join(folded(lines, screen_width())))


class OutputError(OSError):
    """Standard output cannot be written, such as on a full disk; what is stored in files is not concerned."""


class _Output(io.FileIO):
    """A stream whose text is dropped where no process reads it; another error, such as a full disk, is raised once."""

    _failed = False

    def write(self, data: Any) -> int:
        """Write what the system takes."""
        if self._failed:
            # The interpreter tries again at its end, when the error has been reported.
            return memoryview(data).nbytes
        try:
            return super().write(data) or 0
        except BrokenPipeError:
            return memoryview(data).nbytes
        except OSError as error:
            self._failed = True
            raise OutputError(error.errno, error.strerror) from None


class _Messages(io.FileIO):
    """A stream whose text is dropped wherever it cannot be written: a lost message must not end a computation."""

    def write(self, data: Any) -> int:
        """Write what the system takes."""
        try:
            return super().write(data) or 0
        except OSError:
            return memoryview(data).nbytes


class _Visible(io.TextIOWrapper):
    """A text stream that writes escapes for control and direction characters."""

    # stream on the same file for the bar, which moves the cursor and filters its texts itself
    unfiltered: io.TextIOWrapper

    def write(self, text: str) -> int:
        """Write what a terminal can show."""
        if not text.replace("\n", "").isprintable():
            # Only now: `types` imports NumPy.
            from rmpc_bench.types.texts import visible

            text = visible(text)
        return super().write(text)


def usable_streams() -> None:
    """Open closed streams on the null device, and drop what is written where no process reads.

    Streams that another program or a test has put in place are left alone.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            # The lowest free number is taken, which is this one.
            os.open(os.devnull, os.O_RDWR)
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)
    if sys.stdout is None or sys.stdout is sys.__stdout__:
        sys.stdout = _text(_Output(1, "w", closefd=False), sys.stdout)
    if sys.stderr is None or sys.stderr is sys.__stderr__:
        sys.stderr = _text(_Messages(2, "w", closefd=False), sys.stderr, errors="backslashreplace", line_buffering=True)


def _text(raw: io.FileIO, old: Any, *, errors: str = "strict", line_buffering: bool = False) -> io.TextIOWrapper:
    """Return a text stream with the buffering and, except for ASCII, the encoding of the one in whose place it is."""
    encoding = getattr(old, "encoding", None) or "utf-8"
    options: dict[str, Any] = {
        # click would write to the buffer of an ASCII stream, in UTF-8.
        "encoding": "utf-8" if codecs.lookup(encoding).name == "ascii" else encoding,
        "errors": getattr(old, "errors", None) or errors,
        "line_buffering": line_buffering or raw.isatty(),
    }
    made = _Visible(io.BufferedWriter(raw), **options)
    made.unfiltered = io.TextIOWrapper(made.buffer, **options)
    return made
