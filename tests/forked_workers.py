"""Workers and other processes of a run that need not import anything: forks of the process that forks commands.

Most of the time of a short experiment with components of a file goes by before its workers load it.  Tests of what a
process has loaded start new interpreters, as do commands, and all tests where a process cannot adopt another one.
"""

import ctypes
import io
import json
import os
import random
import subprocess
import sys
import threading
import time
import traceback
from contextlib import ExitStack
from fcntl import F_DUPFD, fcntl
from importlib import import_module

import forked_commands

from rmpc_bench import child_process

MODULES = {"rmpc_bench.engines.worker", "rmpc_bench.execution.separation"}
"""What is a fork, of all that runs in processes of its own."""
NEW = {"engines", "test_separation.py"}
"""Folders and files of tests whose workers are new interpreters: what a process has loaded is their subject."""
ADOPTING = 36
"""PR_SET_CHILD_SUBREAPER of Linux: a process whose parent ends becomes a child of this one."""
HIGH = 900
"""Open files from this number on are out of the way of those that a worker is given."""
LONGEST = 60.0
"""Time in which a worker becomes a child of the process that asks for it [s]; it ends if that has ended."""


class Forks:
    """How workers start in this process."""

    start = staticmethod(child_process.start)
    allowed = False


def install():
    """Let workers be forks from now on, where a test allows it; before `engines` is imported."""
    if sys.platform == "linux":
        child_process.start = _start


def _start(module, stdin, stdout, stderr, *, given=None, inherited=(), session=False, **keys):
    """Start a process as `rmpc_bench.child_process.start`."""
    if module not in MODULES or not Forks.allowed or keys:
        keys |= {"given": given, "inherited": inherited, "session": session}
        return Forks.start(module, stdin, stdout, stderr, **keys)
    adopt = ctypes.CDLL(None).prctl
    with ExitStack() as opened:
        files, ours = [], []
        for number, stream in enumerate((stdin, stdout, stderr)):
            theirs, own = _opened(number, stream)
            files.append(theirs)
            ours.append(own)
            if stream in (subprocess.PIPE, subprocess.DEVNULL):
                opened.callback(os.close, theirs)
        adopt(ADOPTING, 1, 0, 0, 0)
        opened.callback(adopt, ADOPTING, 0, 0, 0, 0)
        request = {"numbers": [0, 1, 2, *inherited], "given": given, "path": sys.path, "session": session}
        number = forked_commands.ask([*files, *inherited], module=module, **request)
        # A signal to the number 0 would reach every process of this group.
        if not number:
            raise OSError("no worker could be forked")
        return Forked(number, ours)


def _opened(number, stream):
    """Return the file of a stream of the process, and what is at the other end of a pipe."""
    if stream == subprocess.PIPE:
        reading, writing = os.pipe()
        return (reading, open(writing, "wb")) if number == 0 else (writing, open(reading, "rb"))
    if stream == subprocess.DEVNULL:
        return os.open(os.devnull, os.O_RDWR), None
    return (number if stream is None else stream.fileno()), None


class Forked(subprocess.Popen):
    """A process that was not started here, and is a child of this one."""

    def __init__(self, pid, streams):
        self.args, self.pid, self.returncode = [__name__], pid, None
        self.stdin, self.stdout, self.stderr = streams
        self._child_created, self._waitpid_lock, self._sigint_wait_secs = True, threading.Lock(), 0.25
        self._communication_started, self._input, self.text_mode = False, None, None


def fork(request, files):
    """Fork twice, so that the worker becomes a child of the process that asks for it; return its number."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            worker = os.fork()
            if worker == 0:
                _work(request, files)
            os.write(writing, worker.to_bytes(8))
        finally:
            os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    with open(reading, "rb") as answer:
        return int.from_bytes(answer.read(8))


def _work(request, files):
    """Do the tasks of a worker with these open files, as a process that has just started."""
    try:
        moved = [fcntl(file, F_DUPFD, HIGH) for file in files]
        os.closerange(3, HIGH)
        for file, number in zip(moved, request["numbers"], strict=True):
            os.dup2(file, number)
            os.close(file)
        # What a component prints shortly before it ends the process is wanted most.
        sys.stdin = open(0, closefd=False)
        sys.stdout, sys.stderr = (
            io.TextIOWrapper(open(number, "wb", 0, closefd=False), write_through=True) for number in (1, 2)
        )
        os.environ.clear()
        os.environ.update(request["environ"] | child_process._ENVIRONMENT)
        os.chdir(request["cwd"])
        sys.path[:], sys.argv = request["path"], ["-c", json.dumps([request["path"], request["given"]])]
        random.seed()
        import_module("numpy").random.seed()
        end = time.monotonic() + LONGEST
        while os.getppid() != request["given"]["parent"] and time.monotonic() < end:
            time.sleep(0.0005)
        if request["session"]:
            os.setsid()
        import_module(request["module"]).main(**request["given"])
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(1)
