"""The process behind `probe`: it forks for every request, and ends a fork that takes too long."""

from __future__ import annotations

import os
import pickle
import select
import signal
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from rmpc_bench.components import probe
from rmpc_bench.components.code import CodeError
from rmpc_bench.components.first_call import FirstCall
from rmpc_bench.components.loading import module_of
from rmpc_bench.components.probe import LENGTH, Answer
from rmpc_bench.components.transport import loads

PATIENCE = 6.0
"""Longest time of a request on a busy machine, in multiples of its limit."""


def serve() -> None:
    """Answer requests from standard input until it is closed."""
    probe.is_answering = True
    requests, answers = os.fdopen(os.dup(0), "rb", buffering=0), os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1):
        os.dup2(nowhere, descriptor)
    while (header := _exactly(requests, LENGTH.size)) is not None:
        message = pickle.loads(_exactly(requests, *LENGTH.unpack(header)) or b"")
        _preload(message["modules"])
        answer = pickle.dumps(_in_a_fork(message, requests))
        answers.write(LENGTH.pack(len(answer)) + answer)
        answers.flush()


def _preload(modules: list[str]) -> None:
    """Import modules of the bench here, once for all forks."""
    for name in modules:
        import_module(name)


def handle(request: dict[str, Any], enter: Any) -> Any:
    """Import a file, make the first call of a method, or call a function of the bench; all but the first as bytes.

    `enter` is called with the role of the component whose code runs next.
    """
    if "imports" in request:
        try:
            module_of(Path(request["imports"]))
        except CodeError:
            # The process that asked imports the file as well and reports its errors.
            return None
        return None
    if "call" in request:
        function, *arguments = loads(request["call"])
        return function(*arguments)
    enter("import")
    plant, method, sample = loads(request["first_call"])
    return FirstCall(plant, method, sample, enter).answer()


def _in_a_fork(message: dict[str, Any], requests: BinaryIO) -> Answer:
    """Answer a request in a fork of this process."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _work(message, writing)
    os.close(writing)
    try:
        return _waited(child, reading, requests, message["limit"])
    finally:
        os.close(reading)


def _work(message: dict[str, Any], writing: int) -> None:
    """Do the request and end this fork."""
    try:
        sys.path[:] = message["path"]
        os.chdir(message["directory"])
        done = handle(pickle.loads(message["request"]), lambda role: os.write(writing, _packed(("stage", role))))
        os.write(writing, _packed(("done", done)))
    except Exception:
        # What cannot be made here is made in the process that asked, which reports its errors.
        os.write(writing, _packed(("done", None)))
    finally:
        # Without the exit handlers of the user's libraries, which belong to a process that ends by itself.
        os._exit(0)


def _packed(value: Any) -> bytes:
    data = pickle.dumps(value)
    return LENGTH.pack(len(data)) + data


def _waited(child: int, reading: int, requests: BinaryIO, limit: float) -> Answer:
    """Wait for a fork, until it is done, has died or has taken too long."""
    end, stage, data = time.monotonic() + limit, "", b""
    last = end + (PATIENCE - 1) * limit
    while True:
        watched = [reading, requests.fileno()]
        ready, _, _ = select.select(watched, [], [], max(0.0, end - time.monotonic()))
        if not ready and time.monotonic() < last and waits_for_a_processor(child, limit):
            end = min(last, time.monotonic() + 0.1 * limit)
            continue
        if reading not in ready:
            # Too long, or the process that asked has gone.
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return Answer("timeout", stage=stage)
        received = os.read(reading, 1 << 16)
        data += received
        while len(data) >= LENGTH.size and len(data) >= LENGTH.size + LENGTH.unpack(data[: LENGTH.size])[0]:
            (length,) = LENGTH.unpack(data[: LENGTH.size])
            kind, value = pickle.loads(data[LENGTH.size : LENGTH.size + length])
            data = data[LENGTH.size + length :]
            if kind == "done":
                os.waitpid(child, 0)
                return Answer("done", value, stage)
            stage = value
        if not received:
            _, status = os.waitpid(child, 0)
            return Answer("died", stage=stage, reason=_how(status))


def waits_for_a_processor(child: int, limit: float) -> bool:
    """Whether a process computes or reads a file, and has had less time of the processors than the limit."""
    try:
        with open(f"/proc/{child}/stat", encoding="ascii", errors="replace") as file:
            # State, and ticks of user and system time; the name of the program before them may contain blanks.
            fields = file.read().rpartition(")")[2].split()
    except OSError:
        # Other systems than Linux have no such file.
        return False
    used = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return fields[0] in "RD" and used < limit


def _how(status: int) -> str:
    """Say how a process has ended."""
    if os.WIFSIGNALED(status):
        return f"signal {signal.Signals(os.WTERMSIG(status)).name}"
    return f"exit code {os.WEXITSTATUS(status)}"


def _exactly(stream: BinaryIO, n: int) -> bytes | None:
    """Read n bytes; None at the end of the stream."""
    data = b""
    while len(data) < n:
        part = stream.read(n - len(data))
        if not part:
            return None
        data += part
    return data
