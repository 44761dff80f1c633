"""Checks of a component in a process of its own, so that it can neither hang nor end the kit."""

from __future__ import annotations

import faulthandler
import os
import pickle
import queue
import re
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import IO, Any

from rmpc_bench.child_process import start
from rmpc_bench.conformance.information import SAME_SEED, received
from rmpc_bench.conformance.results import PACKAGE, CheckResult, CheckSequence, Report, raised, with_expected
from rmpc_bench.conformance.stages import CHECKS, MADE, Setting, System, provided, stages
from rmpc_bench.conformance.subject import Subject, group_of, packed, unpacked
from rmpc_bench.conformance.systems import LinearSystem
from rmpc_bench.simulation.threads import single_thread

MODULE = "rmpc_bench.conformance.process"
SECONDS = 30.0
"""Time limit of one check."""
MOST_PROCESSES = 3
"""Processes that a component may end; the checks that are left are then not run."""
_FRAME = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>\d+) in (?P<name>\w+)')


class _Process:
    """The process of the checks, and what it has said; the job ends with the ids of checks to leave out."""

    def __init__(self, job: tuple[Subject, System | None, frozenset[str]], seconds: float) -> None:
        self.seconds = seconds
        self.errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `close`
        pipe = subprocess.PIPE
        self.process = start(
            MODULE, pipe, pipe, self.errors, given={"seconds": seconds}, environment=SAME_SEED, session=True
        )
        self.said: queue.Queue[tuple[str, Any] | None] = queue.Queue()
        """Its messages, and None at its end."""
        self.listener = threading.Thread(target=self._listen, daemon=True)
        self.listener.start()
        assert self.process.stdin is not None
        self.process.stdin.write(packed(job[0], job))
        self.process.stdin.close()

    def _listen(self) -> None:
        stream = self.process.stdout
        assert stream is not None
        try:
            while True:
                self.said.put(pickle.load(stream))
        except (EOFError, pickle.UnpicklingError, ValueError, OSError):
            self.said.put(None)

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
    """Run all checks of a component, on the shipped linear Gaussian system unless another one is given."""
    results: dict[str, CheckResult] = {}
    known: dict[str, Any] = {"group": subject.group, "expected": {}, "warned": ""}
    for _ in range(MOST_PROCESSES):
        with closing(_Process((subject, system, frozenset(results)), seconds)) as process:
            stopped_at, reason = _followed(process, results, known)
        if not stopped_at:
            break
        check = next((each for each in CHECKS.get(known["group"], (MADE,)) if each.id == stopped_at), MADE)
        results[check.id] = check.result("failed", reason)
        if check.is_first:
            break
    listed = CHECKS.get(known["group"], (MADE,))
    missing = next((each.id for each in results.values() if each.status == "failed"), "")
    for check in listed:
        results.setdefault(check.id, check.result("not checked", f"{missing} fails" if missing else ""))
    order = [results[check.id] for check in listed]
    if known["warned"]:
        order.append(CheckResult("warnings", "no call gives a warning", "failed", known["warned"], "information"))
    return Report(subject.text, known["group"], with_expected(order, known["expected"]))


def _followed(process: _Process, results: dict[str, CheckResult], known: dict[str, Any]) -> tuple[str, str]:
    """Collect messages until the end; the check at which it stopped and the reason, or two empty texts."""
    current = MADE.id
    while True:
        try:
            message = process.said.get(timeout=process.seconds)
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


def main(seconds: float) -> None:
    """In the other process: run the checks and write every result to stdout as soon as there is one."""
    faulthandler.enable()
    with received() as (job, out), single_thread():

        def say(word: str, value: Any) -> None:
            """Write a message; a check that takes too long leaves the place where it is on stderr."""
            if word == "begin":
                faulthandler.dump_traceback_later(0.9 * seconds)
            pickle.dump((word, value), out)
            out.flush()

        say("begin", MADE.id)
        try:
            _check_all(job, seconds, say)
        except (Exception, SystemExit) as error:  # a component under test may raise anything
            say("result", MADE.result("failed", raised(error)))
        say("end", None)


def _check_all(job: bytes, seconds: float, say: Callable[[str, Any], None]) -> None:
    """Run the checks of every stage."""
    subject, system, left_out = unpacked(job)
    system, sequence = system or LinearSystem.shipped(), CheckSequence()
    group = group_of(subject, lambda each: provided(each, system, system.n_steps))
    say("group", group)
    for stage in stages(Setting(subject, group, system, seconds)):
        if stage.component is not None:
            declared = getattr(stage.component, "expected_failures", {})
            say("expected", {str(name): str(reason) for name, reason in dict(declared).items()})
        for check in stage.checks:
            if check.id not in left_out:
                say("begin", check.id)
                say("result", sequence.run(check, stage.component, stage.example))
        outcomes = [outcome for _, outcome in getattr(stage.example, "known", {}).values()]
        if texts := dict.fromkeys(text for each in outcomes for text in each.journal.warnings):
            say("warned", "; ".join(texts))
