"""Record of the workers that have ended before their work was done."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from rmpc_bench.execution.engines.attempts import End

LOG = "workers.txt"
"""File in the directory `logs` with a line for every worker that has ended."""


class EndedWorkers:
    """Writes a line for every worker that has ended, and a message for the first one that was disturbed."""

    def __init__(self, logs: Path, say: Callable[[str], None]) -> None:
        self._file, self._say, self._said = logs / LOG, say, False

    def note(self, text: str, end: End) -> None:
        """Note a worker with the attempt that has ended with it, and how it has ended."""
        # A full disk is reported by the trial store, which matters more.
        with suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            with self._file.open("a", encoding="utf-8") as file:
                file.write(f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} {text}\n")
        if end.outside and not self._said:
            self._said = True
            text = f"{end.message}, probably by another program or the system"
            self._say(f"{text}; its runs are repeated (further cases are listed in {self._file})")
