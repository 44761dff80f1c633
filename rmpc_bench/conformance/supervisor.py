"""Checks of a component in a process of its own, so that it can neither hang nor end the kit."""

from __future__ import annotations

import os
import pickle
import queue
import re
import signal
import sys
import tempfile
import threading
from pathlib import Path
from typing import IO, Any

from rmpc_bench.conformance.experiment_example import System
from rmpc_bench.conformance.report import Report
from rmpc_bench.conformance.results import PACKAGE, CheckResult, with_expected
from rmpc_bench.conformance.separate_process import SAME_SEED, started
from rmpc_bench.conformance.stages import CHECKS, MADE
from rmpc_bench.conformance.subject import Subject, packed

MODULE = "rmpc_bench.conformance.checking"
SECONDS = 30.0
"""Time limit of one check."""
MOST_PROCESSES = 3
"""Processes that a component may end; the checks that are left are then not run."""
_FRAME = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>\d+) in (?P<name>\w+)')


class _Process:
    """The process of the checks, and what it has said.

    Parameters
    ----------
    job : subject, system, ids of checks to leave out
    seconds : time limit of a check
    """

    def __init__(self, job: tuple[Subject, System | None, frozenset[str]], seconds: float) -> None:
        self.seconds = seconds
        self.errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `close`
        self.process = started(MODULE, SAME_SEED, errors=self.errors, session=True)
        self.said: queue.Queue[tuple[str, Any] | None] = queue.Queue()
        self.listener = threading.Thread(target=self._listen, daemon=True)
        self.listener.start()
        assert self.process.stdin is not None
        self.process.stdin.write(pickle.dumps((tuple(sys.path), seconds)) + packed(job[0], job))
        self.process.stdin.close()

    def _listen(self) -> None:
        stream = self.process.stdout
        assert stream is not None
        try:
            while True:
                self.said.put(pickle.load(stream))
        except (EOFError, pickle.UnpicklingError, ValueError, OSError):
            self.said.put(None)

    def next(self) -> tuple[str, Any] | None:
        """Return the next message; None where the process has ended.

        Raises
        ------
        queue.Empty
            If there is none within the time limit.
        """
        return self.said.get(timeout=self.seconds)

    def end(self) -> None:
        """End the process and those that it has started."""
        if os.name == "posix":
            try:
                os.killpg(self.process.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
        self.process.kill()
        self.process.wait()
        self.listener.join()

    def close(self) -> None:
        """End the process and close its files."""
        self.end()
        assert self.process.stdout is not None
        self.process.stdout.close()
        self.errors.close()

    def last_frame(self) -> str:
        """Return the place at which the component was when its time was over; empty where it is not known."""
        self.errors.seek(0)
        text = self.errors.read().decode(errors="replace").rpartition("most recent call first")[2]
        for frame in _FRAME.finditer(text):
            if not frame["file"].startswith((PACKAGE, sys.prefix, sys.base_prefix)):
                return f" in {frame['name']} at {Path(frame['file']).name}:{frame['line']}"
        return ""


def check_subject(subject: Subject, *, system: System | None = None, seconds: float = SECONDS) -> Report:
    """Run all checks of a component.

    Parameters
    ----------
    subject : the component
    system : what it is checked on: a linear Gaussian system, the shipped one unless given, or that of an experiment
    seconds : time limit of one check

    Returns
    -------
    One result per check, in the order of the list.
    """
    results: dict[str, CheckResult] = {}
    known: dict[str, Any] = {"group": subject.group, "expected": {}, "warned": ""}
    for _ in range(MOST_PROCESSES):
        process = _Process((subject, system, frozenset(results)), seconds)
        try:
            stopped_at, reason = _followed(process, results, known)
        finally:
            process.close()
        if not stopped_at:
            break
        check = next((each for each in CHECKS.get(known["group"], (MADE,)) if each.id == stopped_at), MADE)
        results[check.id] = CheckResult(check.id, check.says, "failed", reason, check.severity)
        if check.is_first:
            break
    listed = CHECKS.get(known["group"], (MADE,))
    missing = next((each.id for each in results.values() if each.status == "failed"), "")
    for check in listed:
        results.setdefault(
            check.id,
            CheckResult(check.id, check.says, "not checked", f"{missing} fails" if missing else "", check.severity),
        )
    order = [results[check.id] for check in listed if check.id in results]
    if known["warned"]:
        order.append(CheckResult("warnings", "no call gives a warning", "failed", known["warned"], "information"))
    return Report(subject.text, known["group"], with_expected(order, known["expected"]))


def _followed(process: _Process, results: dict[str, CheckResult], known: dict[str, Any]) -> tuple[str, str]:
    """Collect messages until the end; the check at which it stopped and the reason, or two empty texts."""
    current = MADE.id
    while True:
        try:
            message = process.next()
        except queue.Empty:
            process.end()
            text = f"no result within {process.seconds:g} s: an endless loop{process.last_frame()}?"
            return current, f"{text} For a slow component give a longer limit, --seconds {10 * process.seconds:g}"
        if message is None:
            code = process.process.wait()
            word = f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
            return current, f"the process {word}{process.last_frame()}"
        word, value = message
        if word == "begin":
            current = value
        elif word == "result":
            results[value.id] = value
        elif word == "end":
            return "", ""
        else:
            known[word] = value
