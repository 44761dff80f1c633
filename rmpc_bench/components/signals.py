"""Signals while code of a user runs: those that interrupt this process, and the alarm that ends what is too long."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

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

    Time in which the processors are busy with other programs does not count.
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
        computes = used - self.last[1] > _COMPUTING * (now - self.last[0])
        is_early = used - self.start[1] < self.limit and now - self.start[0] < PATIENCE * self.limit
        self.last = now, used
        if self.has_ended or not (computes and is_early):
            self.has_ended = True
            raise self.too_long
