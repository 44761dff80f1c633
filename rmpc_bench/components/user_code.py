"""What code of a user does to this process: signals, an alarm, its part of a traceback, and what it replaces."""

from __future__ import annotations

import builtins
import os
import re
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

from rmpc_bench.extras import missing, missing_extra
from rmpc_bench.registry import BUILT_IN
from rmpc_bench.types import PassedOn

LIMIT = 10.0
"""Longest time of an import or a first call [s]."""
PATIENCE = 6.0
"""Longest time on a busy machine, in multiples of the limit."""
_COMPUTING = 0.05
"""Share of a processor from which on code computes, and does not just wait."""


@contextmanager
def noted_signals() -> Iterator[list[int]]:
    """Note signals that interrupt this process (none in a thread): an exception of a component is not taken for one."""
    arrived: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield arrived
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def note(number: int, frame: FrameType | None) -> None:
        arrived.append(number)
        handler = before[signal.Signals(number)]
        assert callable(handler)
        handler(number, frame)

    for number, handler in before.items():
        if callable(handler):
            signal.signal(number, note)
    try:
        yield arrived
    finally:
        for number, handler in before.items():
            if callable(handler):
                signal.signal(number, handler)


class TooLong(PassedOn):
    """Code of a user has taken longer than `LIMIT`."""


@contextmanager
def limited() -> Iterator[None]:
    """End Python code that takes longer than `LIMIT` with a TooLong; compiled code and other threads go on.

    Time in which the processors are busy with other programs does not count, nor does the compilation by numba.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    alarm = _Alarm()
    handler = signal.signal(signal.SIGALRM, alarm.ring)
    timer = signal.setitimer(signal.ITIMER_REAL, alarm.limit, 0.1 * alarm.limit)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL if handler is None else handler)
        # One of the program, such as the limit of a test.
        signal.setitimer(signal.ITIMER_REAL, *timer)
    if alarm.has_ended:
        # The code has caught the exception.
        raise alarm.too_long


class _Alarm:
    """Ends what computes for as long as the limit or what waits at its end."""

    def __init__(self) -> None:
        self.limit = LIMIT
        self.start = self.last = time.monotonic(), time.process_time()
        self.too_long = TooLong(TimeoutError(f"takes longer than {LIMIT:g} s"))
        self.has_ended = False

    def ring(self, number: int, frame: FrameType | None) -> None:
        """Raise the exception, again and again where it is caught."""
        now, used = time.monotonic(), time.process_time()
        if _compiles(frame):
            self.start = self.start[0], used
        computes = used - self.last[1] > _COMPUTING * (now - self.last[0])
        is_early = used - self.start[1] < self.limit and now - self.start[0] < PATIENCE * self.limit
        self.last = now, used
        if self.has_ended or not (computes and is_early):
            self.has_ended = True
            raise self.too_long


def _compiles(frame: FrameType | None) -> bool:
    """Whether numba compiles, which a user does not write and which happens once."""
    while frame is not None:
        if str(frame.f_globals.get("__name__", "")).startswith(("numba.core.compiler", "numba.core.codegen")):
            return True
        frame = frame.f_back
    return False


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


_ROOTS = frozenset({"numpy", "scipy", "pandas", "rmpc_bench", "builtins", "math", "cmath", "random", "json"})
_VARIABLES = ("NUMBA_", "NPY_", "OMP_", "OPENBLAS_", "MKL_", "BLIS_", "VECLIB_", "NUMEXPR_", "PYTHON")
"""Starts of the names of environment variables that change the numbers of processes that are started later."""
replaced: dict[str, set[str]] = {}
"""Python file of a user -> names of what its import and its designs have replaced in this process."""


@contextmanager
def untouched(file: str = "") -> Iterator[set[str]]:
    """Put back what the code of a file replaces in modules that all use; the set gets the names of what it was.

    It costs some milliseconds and cannot see what compiled code changes.  Methods with other files are therefore also
    computed in processes of their own, see `rmpc_bench.execution.separation`.

    The error state and the printed form of numbers and the variables of the environment are put back without a word:
    files of users often set them for themselves.
    """
    import numpy as np

    found = set[str]()
    holders = [(name, holder, dict(vars(holder))) for name, holder in _holders()]
    kinds = {group: dict(known) for group, known in BUILT_IN.items()}
    variables, state, printing = _variables(), np.geterr(), np.get_printoptions()
    try:
        yield found
    finally:
        for name, holder, before in holders:
            now = vars(holder)
            for key in [key for key, value in before.items() if now.get(key) is not value]:
                if _is_common(key, before[key]):
                    setattr(holder, key, before[key])
                    found.add(f"{name}.{key}")
            # A new name may hide an inherited method, or a function of Python.
            hidden = object if isinstance(holder, type) else builtins
            for key in [key for key, value in now.items() if key not in before and _is_common(key, value)]:
                if hidden is object and not key.startswith("__") or hasattr(hidden, key):
                    delattr(holder, key)
                    found.add(f"{name}.{key}")
        for group, known in kinds.items():
            found |= {f"the kind {key} of {group}" for key in known if BUILT_IN[group].get(key) != known[key]}
            BUILT_IN[group].update(known)
        for variable in {*variables, *_variables()}:
            os.environ.pop(variable, None)
        os.environ.update(variables)
        np.seterr(**state)
        np.set_printoptions(**printing)
        if found and file:
            replaced[file] = replaced.get(file, set()) | found


def _holders() -> Iterator[tuple[str, Any]]:
    """Yield the modules that every component uses, and the classes of the bench, each with its name."""
    # Copies at once: what a garbage collection runs in between may import something.
    for name, module in sys.modules.copy().items():
        if name.partition(".")[0] in _ROOTS and module is not None:
            yield name, module
            if name.startswith("rmpc_bench."):
                for value in vars(module).copy().values():
                    if isinstance(value, type) and value.__module__ == name:
                        yield f"{name}.{value.__qualname__}", value


def _is_common(key: str, before: Any) -> bool:
    """Whether others use an entry of a module; its caches and counters may change."""
    constant = isinstance(before, bool | int | float | complex | str | tuple) and key.isupper()
    return (
        constant
        or isinstance(before, (float, property, classmethod, staticmethod))
        or (callable(before) and not key.startswith("__abc"))
    )


def _variables() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name.startswith(_VARIABLES)}
