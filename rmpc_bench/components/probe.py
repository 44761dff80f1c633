"""Trial calls of a user's code in a process of its own, with a limit of time, before it runs in this one.

A process is started once and kept.  It answers every request in a fork of itself, so that an endless loop, an exit or a
crash of the user's code ends nothing else, and no request sees what another has left behind.
"""

from __future__ import annotations

import atexit
import os
import pickle
import struct
import sys
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from rmpc_bench.components.code import CodeError, CodeReference

if TYPE_CHECKING:
    import subprocess

LIMIT = 10.0
"""Longest time of a request [s]; time in which the processors are busy with other programs does not count."""
LENGTH = struct.Struct("<Q")
"""Length of a message in bytes, which stands before it."""
_PRELOADED = tuple(f"rmpc_bench.{room}." for room in ("components", "estimators", "controllers", "plants", "models"))
"""Modules of the bench that the process imports before it forks."""
_CHILD = "from rmpc_bench.components.probe_process import serve; serve()"


class Answer(NamedTuple):
    """How a request ended."""

    outcome: str
    """``done``, ``timeout`` or ``died``."""
    value: Any = None
    """What the request returned."""
    stage: str = ""
    """The component whose code ran last."""
    reason: str = ""
    """How the process died."""


_imported: set[tuple[str, str]] = set()
"""Files whose import has ended well, with their hashes."""
_process: list[subprocess.Popen[bytes]] = []
"""The process of this program, once it has been started."""
is_answering = False
"""Whether this is that process, or a fork of it: code of the user may run here."""
_in_use = threading.Lock()
"""Threads of a program share the process; one request at a time."""


def ask(request: Mapping[str, Any], limit: float | None = None) -> Answer:
    """Send the keywords of `probe_process.handle` to the process and wait for its answer, for `LIMIT` unless given."""
    if is_answering:
        return Answer("done")
    limit = LIMIT if limit is None else limit
    modules = [name for name in sys.modules if name.startswith(_PRELOADED)]
    surroundings = {"path": list(sys.path), "directory": os.getcwd(), "limit": limit, "modules": modules}
    message = pickle.dumps({**surroundings, "request": pickle.dumps(dict(request))})
    with _in_use:
        try:
            return _answer(message)
        except (BrokenPipeError, EOFError, struct.error):
            # The process was ended from outside; it is started again once.
            return _answer(message)


def _answer(message: bytes) -> Answer:
    process = _started()
    assert process.stdin is not None and process.stdout is not None
    try:
        process.stdin.write(LENGTH.pack(len(message)) + message)
        process.stdin.flush()
        (length,) = LENGTH.unpack(process.stdout.read(LENGTH.size))
        answer: Answer = pickle.loads(process.stdout.read(length))
    except BaseException:
        # After Ctrl-C the answer is still to come; the next request would take it for its own.
        close()
        raise
    return answer


def check_import(reference: CodeReference, version: str) -> None:
    """Import a user's file in the process, before it is imported in this one; once per version.

    A CodeError says that the import takes too long or ends the process.  Other errors are those of the import here.
    """
    key = str(reference.path), version
    if key in _imported:
        return
    answer = ask({"imports": str(reference.path)})
    if answer.outcome == "timeout":
        raise CodeError(
            f"{reference.file}: its import takes longer than {LIMIT:g} s; move what it computes into `prepare`"
        )
    if answer.outcome == "died":
        raise CodeError(f"{reference.file}: its import ends the process ({answer.reason})")
    _imported.add(key)


def close() -> None:
    """End the process, if there is one."""
    while _process:
        process = _process.pop()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                try:
                    stream.close()
                except BrokenPipeError:
                    continue
        process.kill()
        process.wait()


def _started() -> subprocess.Popen[bytes]:
    if not _process:
        # Imported here: a configuration without files of the user starts no process.
        import subprocess

        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(each for each in sys.path if each)}
        process = subprocess.Popen(
            # -P: a file of the current directory with the name of a standard module is not imported in its place.
            [sys.executable, "-P", "-c", _CHILD],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            # Ctrl-C in a terminal reaches every process of the group; only this one handles it.
            start_new_session=True,
        )
        _process.append(process)
        atexit.register(close)
    return _process[0]
