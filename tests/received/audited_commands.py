"""`rmpc-bench` in forks of one process that has imported everything, each under the audit hook of `audit.py`.

The process that forks has run every command once, so that a fork need not load fonts, templates and compiled code.
"""

import gc
import json
import os
import pkgutil
import resource
import signal
import subprocess
import sys
import threading
import time
import traceback
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
SECONDS = 10.0
"""Longest processor time of a command."""
PATIENCE = 30.0
"""Time after which a command that waits is killed [s]; the processors may be busy with other programs."""
ADDRESSES = 4 << 30
"""Address space that a command may take beyond that of the process that forks: a bomb does not take the machine."""


class Outcome(NamedTuple):
    """How a command ended.

    Parameters
    ----------
    code : its exit code; negative if it was killed
    seconds : processor time
    waited : time on the clock [s]
    mb : its largest memory, with what it shares with the process that forks
    stopped : what the audit hook has stopped
    """

    argv: tuple
    code: int
    out: str
    err: str
    seconds: float
    waited: float
    mb: float
    stopped: tuple


class Server:
    """The process that forks; one command at a time.

    Parameters
    ----------
    directory : for its own files
    """

    def __init__(self, directory):
        self.directory = Path(directory)
        for name in ("home", "matplotlib", "tmp", "warm"):
            (self.directory / name).mkdir(parents=True)
        environment = {each: os.environ[each] for each in os.environ if not each.startswith(("RMPC_BENCH", "GIT_"))}
        environment |= {
            "PYTHONPATH": os.pathsep.join(map(str, (HERE / "startup", HERE.parent, HERE.parents[1]))),
            "RMPC_BENCH_TEST_AUDIT": "{}",
            "HOME": str(self.directory / "home"),
            "MPLCONFIGDIR": str(self.directory / "matplotlib"),
            "TMPDIR": str(self.directory / "tmp"),
        }
        code = "from received.audited_commands import serve; serve()"
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", code, str(self.directory / "warm")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            cwd=self.directory,
            env=environment,
            text=True,
        )

    def run(self, argv, *, cwd, tmp, write=(), hostile=(), code=(), git=False, environ=None):
        """Run a command in a fork and return its `Outcome`; the keywords are those of `audit.Policy`."""
        files = {name: self.directory / name for name in ("out", "err", "log")}
        for file in files.values():
            file.write_bytes(b"")
        caches = [os.environ.get("NUMBA_CACHE_DIR", tmp), self.directory / "matplotlib"]
        policy = {"write": [*write, tmp, *caches], "hostile": hostile, "code": code, "git": git}
        policy["log"] = files["log"]
        request = {"argv": argv, "cwd": cwd, "policy": policy, "out": files["out"], "err": files["err"]}
        request["environ"] = {"TMPDIR": str(tmp), **(environ or {})}
        self._process.stdin.write(json.dumps(request, default=str) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        out, err, log = (file.read_bytes().decode(errors="replace") for file in files.values())
        return Outcome(tuple(map(str, argv)), out=out, err=err, stopped=tuple(log.splitlines()), **answer)

    def close(self):
        """End the process."""
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


def serve():
    """Run commands until standard input is closed."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    _warm(Path(sys.argv[1]))
    sys.stdout.flush()
    gc.collect()
    gc.freeze()
    for line in sys.stdin:
        request = json.loads(line)
        start = time.monotonic()
        child = os.fork()
        if child == 0:
            _command(request)
        code, used = _ended(child, start)
        answer = {"code": code, "seconds": used.ru_utime + used.ru_stime, "waited": time.monotonic() - start}
        print(json.dumps(answer | {"mb": used.ru_maxrss / 1000}), file=answers, flush=True)


def _ended(child, start):
    """Wait for a command, or kill it and its workers when it takes too long."""
    pause, killed = 0.001, False
    while True:
        number, status, used = os.wait4(child, os.WNOHANG)
        if number:
            break
        if time.monotonic() - start > PATIENCE and not killed:
            os.killpg(child, signal.SIGKILL)
            killed = True
        time.sleep(pause)
        pause = min(2 * pause, 0.01)
    try:
        os.killpg(child, signal.SIGKILL)  # workers that it has left
    except ProcessLookupError:
        pass
    return os.waitstatus_to_exitcode(status), used


def _warm(directory):
    """Import everything, and run every command once with an honest experiment."""
    from forked_commands import LIBRARIES, OPTIONAL

    import rmpc_bench

    own = (each.name for each in pkgutil.walk_packages(rmpc_bench.__path__, "rmpc_bench."))
    for name in (*LIBRARIES, "gymnasium", "fmpy", *own):
        if not name.startswith(OPTIONAL):
            try:
                import_module(name)
            except ModuleNotFoundError:
                if name not in ("gymnasium", "fmpy"):
                    raise
    from received.honest import write_plain

    path, out, archive = write_plain(directory), directory / "out", directory / "out.zip"
    for words in (
        ("run", path, "-o", out, "-j", "1", "--progress", "none"),
        ("check", path),
        ("report", out),
        ("pack", out, "-o", archive),
        ("verify", archive, "-j", "1"),
        ("show", out, "--run", "0", "--method", "S-MPC"),
    ):
        _main(words)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _main(words):
    """Run a command here; anything but success ends the process."""
    try:
        import_module("rmpc_bench.cli").main([str(each) for each in words], prog_name="rmpc-bench")
    except SystemExit as end:
        if end.code:
            raise


def _command(request):
    """Run a command in a fork, and end it as an interpreter ends, without taking its modules apart."""
    code = 1
    try:
        os.setsid()
        for number, name in ((0, os.devnull), (1, request["out"]), (2, request["err"])):
            file = os.open(name, os.O_RDWR)
            os.dup2(file, number)
            os.close(file)
        os.environ.update(request["environ"])
        import tempfile

        tempfile.tempdir = None
        os.chdir(request["cwd"])
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + ADDRESSES, size + ADDRESSES))
        resource.setrlimit(resource.RLIMIT_CPU, (int(2 * SECONDS), int(2 * SECONDS) + 1))
        sys.argv = ["rmpc-bench", *map(str, request["argv"])]
        sys.modules["rmpc_bench_test_audit"].arm(**request["policy"])
        import_module("rmpc_bench.cli").main(prog_name="rmpc-bench")
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        traceback.print_exc()
    finally:
        threading._shutdown()
        import atexit

        atexit._run_exitfuncs()
        sys.stdout.flush(), sys.stderr.flush()
        os._exit(code & 0xFF)
