"""Exit codes, and the exit code of every exception."""

from __future__ import annotations

import functools
import signal
import sys
import traceback
from collections.abc import Callable, Mapping
from types import FrameType
from typing import TYPE_CHECKING, Any, ParamSpec

import click

from rmpc_bench.cli.streams import OutputError, screen_width

if TYPE_CHECKING:
    from rmpc_bench.publishing.pages import Publication

FINDING_DIFFERS = 1
USAGE = 2
TOO_MANY_FAILURES = 3
STOP_UNMET = 4
OCCUPIED = 5
INTERNAL = 70
CANNOT_WRITE = 74
INTERRUPTED = 130
TERMINATED = 143
MEANINGS: Mapping[int, str] = {
    INTERRUPTED: "Ctrl-C; finished blocks of a run are stored",
    TERMINATED: "SIGTERM; finished blocks of a run are stored",
    CANNOT_WRITE: "results or the output cannot be written",
    INTERNAL: "internal error",
    OCCUPIED: "the directory holds another experiment, another process writes to it, or versions of libraries differ",
    USAGE: "an option or the configuration is wrong, or a stored file is damaged",
    TOO_MANY_FAILURES: "more runs have failed than `execution.max_failures`",
    STOP_UNMET: "the rule under `stop` is not met with `max_runs`",
    FINDING_DIFFERS: "a difference: with `--strict` the finding of a claim differs from its record, `compare` finds "
    "two experiments different, `verify` finds computed results different from packed ones, a replay differs from what "
    "is stored, or a check of a component fails",
    0: "otherwise",
}  # meaning of every exit code, in the order of precedence

_LEFT: Mapping[str, str] = {
    "run": "finished blocks are stored, the same command continues",
    "import_": "the table is unchanged, the same command imports it again",
    "merge": "the shards are unchanged, the same command joins them again",
    "report": "stored trials are unchanged, the same command writes the report again",
    "pack": "the results are unchanged, the same command packs them again",
    "verify": "nothing was verified, the same command starts again",
}  # what an interrupted command leaves
_UNCHANGED = "this command changes no results"

P = ParamSpec("P")


class Terminated(BaseException):
    """SIGTERM has arrived."""


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated


def guarded(command: Callable[P, int | None]) -> Callable[P, None]:
    """Turn what a verb raises into a message on stderr and an exit code; its return value is the code otherwise."""

    @functools.wraps(command)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> None:
        signal.signal(signal.SIGTERM, _terminate)
        try:
            code = command(*args, **kwargs) or 0
        except (click.exceptions.Exit, click.ClickException, BrokenPipeError):
            raise  # click ends these as every other program does
        except BaseException as error:  # the last place where anything can be caught
            code = _explain(error, command.__name__)
        sys.exit(code)

    return wrapper


def show(written: Publication, seconds: float | None = None, *, notes: bool = True) -> int:
    """Print the summary of what was published, with the duration [s], and notes on stderr; return the exit code."""
    if notes:
        for text in notes_of(written):
            click.echo(text, err=True)
    click.echo(written.summary(seconds, screen_width()))
    return code_of(written, strict=False)


def notes_of(written: Publication) -> list[str]:
    """Return the lines for stderr: rows of other code, remarks, and figures that are left out."""
    other = written.results.other_code
    lines = [f"{other}; `rmpc-bench run` computes them again"] if other else []
    return [*lines, *written.remarks, *(f"figure left out: {text}" for text in written.left_out)]


def code_of(written: Publication, *, strict: bool) -> int:
    """Return the exit code of results: failed runs, then a stopping rule, then, with `strict`, findings that differ."""
    if written.results.trials.n_failed_trials > written.results.experiment.max_failures:
        return TOO_MANY_FAILURES
    stop = written.results.experiment.stop
    if stop is not None and stop.is_unmet:
        return STOP_UNMET
    return FINDING_DIFFERS if strict and written.differing else 0


def code_of_store(error: Exception) -> int:
    """Return the exit code of a directory that cannot be used: it is damaged, or it holds something else."""
    from rmpc_bench.received.plain_files import DamagedError

    return USAGE if isinstance(error, DamagedError) else OCCUPIED


def _explain(error: BaseException, verb: str) -> int:
    if isinstance(error, OutputError):
        return _say(f"the output cannot be written: {error}; results in files are not affected", CANNOT_WRITE)
    if isinstance(error, KeyboardInterrupt):
        return _say(f"interrupted; {_LEFT.get(verb, _UNCHANGED)}", INTERRUPTED)
    if isinstance(error, Terminated):
        return _say(f"terminated; {_LEFT.get(verb, _UNCHANGED)}", TERMINATED)
    # Only now: an import that was interrupted must not be begun again.
    from rmpc_bench.components.loading import described, place_of
    from rmpc_bench.received.archive import ArchiveError
    from rmpc_bench.received.plain_files import StoreError
    from rmpc_bench.received.store import MissingError, WriteError
    from rmpc_bench.types import ConfigError
    from rmpc_bench.types.errors import WorkerError

    if isinstance(error, ArchiveError | ConfigError | MissingError | WorkerError):
        return _say(error, USAGE)
    if isinstance(error, StoreError):
        return _say(error, code_of_store(error))
    if isinstance(error, WriteError):
        return _say(f"results cannot be written: {error}; what was stored before is intact", CANNOT_WRITE)
    if place := place_of(error):
        # The error comes from code of the user.
        return _say(f"{place.file}:{place.line}: {described(error)}", USAGE)
    if isinstance(error, IsADirectoryError):
        return _say(f"{error.filename2 or error.filename}: is a directory; move it away, a file has this name", USAGE)
    if isinstance(error, FileExistsError | NotADirectoryError) and error.filename:
        return _say(f"{error.filename}: a file is in the place of this directory; choose another one", USAGE)
    if isinstance(error, OSError):
        return _say(f"results cannot be written: {error}; stored trials are intact", CANNOT_WRITE)
    traceback.print_exception(error)
    return _say("internal error; this is a bug, please report it with the lines above", INTERNAL)


def _say(what: Any, code: int) -> int:
    click.echo(str(what), err=True)
    return code
