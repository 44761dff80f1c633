"""Progress of a running experiment on the screen; all output goes to stderr."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol


class Progress(Protocol):
    """Display of finished trials and of messages to the user."""

    def start(self, title: str, total: int, done: int) -> None:
        """Begin with ``done`` of ``total`` trials stored already."""

    def advance(self, n: int) -> None:
        """Count ``n`` more trials as stored."""

    def say(self, text: str) -> None:
        """Show a line."""

    def stop(self) -> None:
        """End the display."""


class Silent:
    """Shows messages only."""

    def start(self, title: str, total: int, done: int) -> None:
        """Begin."""

    def advance(self, n: int) -> None:
        """Count."""

    def say(self, text: str) -> None:
        """Show a line."""
        print(text, file=sys.stderr, flush=True)

    def stop(self) -> None:
        """End."""


class Plain(Silent):
    """A line every few seconds, for logs."""

    def __init__(self, seconds: float = 5.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._seconds, self._clock = seconds, clock

    def start(self, title: str, total: int, done: int) -> None:
        """Begin."""
        self._title, self._total, self._done = title, total, done
        self._started = self._shown = self._clock()
        self._before = done
        already = f", {done} stored already" if done else ""
        self.say(f"{title}: {total} trials{already}")

    def advance(self, n: int) -> None:
        """Count, and show a line when the last one is some seconds old."""
        self._done += n
        now = self._clock()
        if now - self._shown >= self._seconds:
            self._shown = now
            rate = (self._done - self._before) / max(now - self._started, 1e-9)
            left = (self._total - self._done) / max(rate, 1e-9)
            self.say(f"{self._title}: {self._done} of {self._total} trials, {left:.0f} s left")


class Bar:
    """A bar on a terminal."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Rich

        columns: list[Any] = [
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        ]
        self._rich = Rich(*columns, console=Console(stderr=True), transient=True)

    def start(self, title: str, total: int, done: int) -> None:
        """Begin."""
        self._task = self._rich.add_task(f"{title} [trials]".replace("[", r"\["), total=total, completed=done)
        self._rich.start()

    def advance(self, n: int) -> None:
        """Move the bar."""
        self._rich.advance(self._task, n)

    def say(self, text: str) -> None:
        """Show a line above the bar."""
        self._rich.console.print(text, markup=False, highlight=False)

    def stop(self) -> None:
        """Remove the bar."""
        self._rich.stop()


def choose(how: str) -> Progress:
    """Return the display for ``auto``, ``bar``, ``plain`` or ``none``."""
    if how == "auto":
        how = "bar" if sys.stderr.isatty() else "plain"
    kinds: dict[str, Callable[[], Progress]] = {"bar": Bar, "plain": Plain, "none": Silent}
    return kinds[how]()


@contextmanager
def said_if_slow(progress: Progress, text: str, seconds: float = 1.0) -> Iterator[None]:
    """Show a message only when the work inside takes longer than ``seconds``."""
    timer = threading.Timer(seconds, progress.say, [text])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
