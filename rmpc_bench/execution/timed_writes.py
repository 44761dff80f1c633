"""Blocks that wait to be written: they are committed together, at most half a second after the first of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import RLock, Timer

from rmpc_bench.child_process import held
from rmpc_bench.execution.database import Database, StoreError, WriteError

INTERVAL = 0.5
"""Longest time that a block waits [s]; a process that is killed loses no more than the blocks of this time."""
LARGEST = 32_000_000
"""Size of the numbers that may wait [bytes]."""
Write = Callable[[], None]
"""Writes a block inside a transaction."""


class TimedWrites:
    """Writes to an open database, collected into one transaction per half a second.

    A timer commits what waits while the calling thread computes.  All access to the database goes through `lock`.
    """

    def __init__(self, database: Database) -> None:
        self.lock = RLock()
        self._database = database
        self._waiting: list[Write] = []
        self._size = 0
        self._at_end: list[tuple[Write, Callable[[], None]]] = []
        self._timer: Timer | None = None
        self._last = -INTERVAL
        self._error: StoreError | WriteError | None = None

    def at_end(self, write: Write, forget: Callable[[], None]) -> None:
        """Call a function inside every transaction at its end, and another one when it is rolled back."""
        self._at_end.append((write, forget))

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Commit what waits, and let nobody else use the database meanwhile."""
        with self.lock:
            self.flush()
            yield

    def add(self, write: Write, size: int = 0) -> None:
        """Write now if many bytes wait or the last commit is longer ago than the interval, else at its end."""
        with self.lock:
            self._waiting.append(write)
            self._size += size
            left = self._last + INTERVAL - time.monotonic()
            if left <= 0.0 or self._size > LARGEST:
                self.flush()
            elif self._timer is None:
                self._timer = Timer(left, self._on_time)
                self._timer.daemon = True
                # Ctrl-C and SIGTERM belong to the main thread, which may delay them.
                with held():
                    self._timer.start()

    def now(self, write: Write) -> None:
        """Write everything that waits and this, at once."""
        with self.lock:
            self._waiting.append(write)
            self.flush()

    def flush(self) -> None:
        """Commit what waits; `WriteError` if this or an earlier write has failed."""
        with self.lock:
            self._stop_timer()
            if self._waiting:
                try:
                    self._commit(self._waiting)
                    self._waiting.clear()
                except WriteError:
                    self._commit_one_by_one()
                self._last, self._size = time.monotonic(), 0
            error, self._error = self._error, None
            if error is not None:
                raise error

    def _on_time(self) -> None:
        with self.lock:
            self._timer = None
            try:
                self.flush()
            except (StoreError, WriteError) as error:
                # Raised by the next call of the thread that computes.
                self._error = error

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _commit_one_by_one(self) -> None:
        """Store as many as there is room for, and drop the others."""
        try:
            while self._waiting:
                self._commit(self._waiting[:1])
                del self._waiting[0]
        except WriteError:
            self._waiting.clear()
            raise

    def _commit(self, writes: list[Write]) -> None:
        try:
            with self._database.transaction():
                for write in (*writes, *(write for write, _ in self._at_end)):
                    write()
        except BaseException:
            for _, forget in self._at_end:
                forget()
            raise
