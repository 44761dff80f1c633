"""The process in which a component is checked; it reports every result as soon as there is one."""

from __future__ import annotations

import faulthandler
import os
import pickle
import sys
from typing import Any, BinaryIO

from rmpc_bench.conformance.linear_system import LinearSystem
from rmpc_bench.conformance.results import CheckResult, not_checked, raised, run_check
from rmpc_bench.conformance.stages import MADE, Setting, provided, stages
from rmpc_bench.conformance.subject import group_of, unpacked
from rmpc_bench.simulation.threads import single_thread


def main() -> None:
    """Read a job from stdin and write messages to stdout."""
    out = os.fdopen(os.dup(1), "wb")
    # What the component prints goes where the errors go.
    os.dup2(2, 1)
    with os.fdopen(0, "rb") as stream:
        search_path, seconds = pickle.load(stream)
        job = stream.read()
    sys.path[:] = [path for path in search_path if path]
    faulthandler.enable()
    with single_thread():
        _Checking(out, seconds).all(job)
    out.flush()
    # Threads and handlers at exit of the component's libraries may wait for each other.
    os._exit(0)


class _Checking:
    """Runs all checks of a component.

    Parameters
    ----------
    out : stream of the messages
    seconds : time limit of a check
    """

    def __init__(self, out: BinaryIO, seconds: float) -> None:
        self.out, self.seconds, self.first = out, seconds, ""

    def say(self, word: str, value: Any) -> None:
        """Write a message; a check that takes too long leaves the place where it is on stderr."""
        if word == "begin":
            faulthandler.dump_traceback_later(0.9 * self.seconds)
        pickle.dump((word, value), self.out)
        self.out.flush()

    def all(self, job: bytes) -> None:
        """Run the checks of every stage.

        Parameters
        ----------
        job : subject, linear system or None, and the ids of checks that an earlier process has run
        """
        self.say("begin", MADE.id)
        try:
            subject, system, left_out = unpacked(job)
            system = system or LinearSystem.shipped()
            group = group_of(subject, lambda each: provided(each, system, system.n_steps))
            self.say("group", group)
            for stage in stages(Setting(subject, group, system, self.seconds)):
                if stage.component is not None:
                    self.say("expected", expected_failures(stage.component))
                for check in stage.checks:
                    if check.id not in left_out:
                        self.one(check, stage.component, stage.example)
                outcomes = [outcome for _, outcome in getattr(stage.example, "known", {}).values()]
                if texts := dict.fromkeys(text for each in outcomes for text in each.journal.warnings):
                    self.say("warned", "; ".join(texts))
        except (Exception, SystemExit) as error:  # a component under test may raise anything
            self.say("result", CheckResult(MADE.id, MADE.says, "failed", raised(error)))
        self.say("end", None)

    def one(self, check: Any, component: Any, example: Any) -> None:
        """Run a check, unless one that comes first has failed."""
        self.say("begin", check.id)
        result = run_check(check, component, example) if not self.first else not_checked(check, self.first)
        if check.is_first and result.status == "failed":
            self.first = check.id
        self.say("result", result)


def expected_failures(design: Any) -> dict[str, str]:
    """Return the failures that a component declares: id of a check -> reason."""
    declared = getattr(design, "expected_failures", {})
    return {str(name): str(reason) for name, reason in dict(declared).items()}
