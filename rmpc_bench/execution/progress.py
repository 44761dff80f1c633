"""Progress of a running experiment on the screen; all output goes to stderr."""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rmpc_bench import notices

if TYPE_CHECKING:
    from rmpc_bench.results.running import RunningComparison

SECONDS = 1.0
"""Time between two looks of a bar at the comparison so far [s]."""


class Progress:
    """Display of finished trials and of messages to the user; this one shows messages only."""

    def start(self, title: str, total: int, done: int, running: RunningComparison | None = None) -> None:
        """Begin with ``done`` of ``total`` trials stored already; `running` compares the methods so far."""

    def advance(self, n: int) -> None:
        """Count ``n`` more trials as stored."""

    def found(self, n: int) -> None:
        """Count ``n`` trials as stored that an earlier session has computed; they say nothing of the rate."""

    def extend(self, n: int) -> None:
        """Add ``n`` trials to those that are to be computed."""

    def say(self, text: str) -> None:
        """Show a line."""
        notices.say(text)

    def stop(self) -> None:
        """End the display."""


class Quiet(Progress):
    """Shows nothing."""

    def say(self, text: str) -> None:
        """Show nothing."""


class Plain(Progress):
    """A line every few seconds [s], for logs; `clock` returns the time [s]."""

    def __init__(self, seconds: float = 5.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._seconds, self._clock = seconds, clock

    def start(self, title: str, total: int, done: int, running: RunningComparison | None = None) -> None:
        """Begin."""
        self._title, self._total, self._done, self._running = title, total, done, running
        self._started = self._shown = self._clock()
        self._before = done
        self._begin()

    def advance(self, n: int) -> None:
        """Count, and show a line when the last one is some seconds old."""
        self._done += n
        now = self._clock()
        if now - self._shown >= self._seconds:
            self._shown = now
            self._show(now - self._started)

    def found(self, n: int) -> None:
        """Count what an earlier session has computed."""
        self._done += n
        self._before += n

    def extend(self, n: int) -> None:
        """Count what is still to be computed."""
        self._total += n

    def _left(self, seconds: float) -> float | None:
        """Return the time that is left at the rate since the start [s]; None before a trial is finished."""
        computed = self._done - self._before
        return (self._total - self._done) * seconds / computed if computed else None

    def _begin(self) -> None:
        already = f", {self._done} stored already" if self._done else ""
        self.say(f"{self._title}: {self._total} trials{already}")

    def _show(self, seconds: float) -> None:
        so_far = self._running.text() if self._running is not None else ""
        left = self._left(seconds)
        line = f"{self._title}: {self._done} of {self._total} trials" + ("" if left is None else f", {left:.0f} s left")
        self.say(f"{line}; {so_far}" if so_far else line)


class Called(Plain):
    """Calls a function of the user with the finished trials, all trials and a text."""

    def __init__(self, function: Callable[[int, int, str], Any]) -> None:
        super().__init__(0.0)
        self._function = function

    def _begin(self) -> None:
        self._show(0.0)

    def _show(self, seconds: float) -> None:
        self._function(self._done, self._total, self._title)


class JsonLines(Plain):
    """One JSON object per line, for programs: `event` is start, progress, message or stop."""

    def __init__(self, seconds: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(seconds, clock)

    def say(self, text: str) -> None:
        """Show a line."""
        self._write("message", text=text)

    def stop(self) -> None:
        """End."""
        self._write("stop", **self._counts(self._clock() - self._started))

    def _begin(self) -> None:
        self._write("start", experiment=self._title, **self._counts(0.0))

    def _show(self, seconds: float) -> None:
        left = self._left(seconds)
        self._write("progress", **self._counts(seconds), left_seconds=None if left is None else round(left, 1))

    def _counts(self, seconds: float) -> dict[str, Any]:
        rows = self._running.rows() if self._running is not None else []
        numbers = [{key: _finite(value) for key, value in row._asdict().items()} for row in rows]
        return {"done": self._done, "trials": self._total, "seconds": round(seconds, 3), "comparison": numbers}

    def _write(self, event: str, **fields: Any) -> None:
        print(json.dumps({"event": event, **fields}, allow_nan=False), file=sys.stderr, flush=True)


def _finite(value: Any) -> Any:
    """Replace what JSON has no number for by null; round what is only shown."""
    if not isinstance(value, float):
        return value
    return float(f"{value:.6g}") if math.isfinite(value) else None


class Bar(Progress):
    """A bar on a terminal, with the comparison so far below it; NO_COLOR switches its colours off."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Rich
        from rich.text import Text

        from rmpc_bench.types.texts import visible

        class Visible(Console):
            """A terminal that gets escapes for control and direction characters, except for those of the bar."""

            def render(self, *args: Any, **kwargs: Any) -> Iterator[Any]:
                """Yield the pieces to write."""
                for piece in super().render(*args, **kwargs):
                    yield piece if piece.control else piece._replace(text=visible(piece.text))

        class WithComparison(Rich):
            """The bar, and a line below it."""

            so_far = ""

            def get_renderables(self) -> Iterator[Any]:
                """Yield the bar and the line."""
                yield from super().get_renderables()
                if self.so_far:
                    yield Text(self.so_far, no_wrap=True, overflow="ellipsis")

        columns: list[Any] = [
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        ]
        self._rich = WithComparison(
            *columns, console=Visible(file=getattr(sys.stderr, "unfiltered", sys.stderr)), transient=True
        )
        self._clock, self._shown = clock, -math.inf

    def start(self, title: str, total: int, done: int, running: RunningComparison | None = None) -> None:
        """Begin."""
        self._running = running
        self._task = self._rich.add_task(f"{title} [trials]".replace("[", r"\["), total=total, completed=done)
        self._rich.start()

    def advance(self, n: int) -> None:
        """Move the bar."""
        now = self._clock()
        if self._running is not None and now - self._shown >= SECONDS:
            self._shown = now
            self._rich.so_far = self._running.text()
        self._rich.advance(self._task, n)

    def found(self, n: int) -> None:
        """Move the bar."""
        self._rich.advance(self._task, n)

    def extend(self, n: int) -> None:
        """Count what is still to be computed."""
        task = self._rich.tasks[self._task]
        self._rich.update(self._task, total=(task.total or 0) + n)

    def say(self, text: str) -> None:
        """Show a line above the bar."""
        self._rich.console.print(text, markup=False, highlight=False)

    def stop(self) -> None:
        """Remove the bar."""
        self._rich.stop()


HOW = ("auto", "bar", "plain", "json", "none")
"""The ways to show progress."""


def choose(how: str) -> Progress:
    """Return the display for one of `HOW`; ``auto`` is a bar on a terminal that can draw one, else plain lines."""
    if how == "auto":
        how = "bar" if sys.stderr.isatty() and os.environ.get("TERM") != "dumb" else "plain"
    kinds: dict[str, Callable[[], Progress]]
    kinds = {"bar": Bar, "plain": Plain, "json": JsonLines, "none": Progress, "quiet": Quiet}
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
