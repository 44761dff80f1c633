"""`rmpc-bench` in processes of their own that need not import anything: forks of one process that has.

Most of the time of a short command goes by before its first line of work.  Tests of starting, of what is imported, of
signals and of closed streams start a new interpreter instead.
"""

import atexit
import gc
import json
import os
import pkgutil
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from functools import cache
from importlib import import_module
from pathlib import Path

OPTIONAL = ("rmpc_bench.adapters.", "rmpc_bench.__main__")
CONNECTION = "RMPC_BENCH_TEST_CONNECTION"
"""Variable with the number of the open file that leads to the process that forks."""
LIBRARIES = (
    "scipy.stats",
    "scipy.linalg",
    "scipy.optimize",
    "pandas",
    "numba",
    "matplotlib.figure",
    "matplotlib.style",
)


def run(arguments, cwd):
    """Return what `subprocess.run` returns for ``rmpc-bench`` with these arguments in a directory, with its text."""
    command = ["rmpc-bench", *map(str, arguments)]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err, open(os.devnull, "rb") as nothing:
        code = _ask(_server(), command, cwd, [each.fileno() for each in (nothing, out, err)])
        out.seek(0), err.seek(0)
        return subprocess.CompletedProcess(command, code, out.read().decode(), err.read().decode())


def variable():
    """Return the environment in which a child that inherits open files calls `run_in_child`."""
    connection = _server()
    connection.set_inheritable(True)
    return {CONNECTION: str(connection.fileno())}


def run_in_child(arguments):
    """Return the exit code of ``rmpc-bench`` with these arguments and the streams of this process, None without one."""
    try:
        connection = socket.socket(fileno=int(os.environ[CONNECTION]))
    except (KeyError, OSError):
        return None
    return _ask(connection, ["rmpc-bench", *arguments], os.getcwd(), [0, 1, 2])


def _ask(connection, command, cwd, streams):
    request = json.dumps({"argv": command, "cwd": str(cwd), "environ": dict(os.environ)}).encode()
    socket.send_fds(connection, [len(request).to_bytes(8)], streams)
    connection.sendall(request)
    return int.from_bytes(connection.recv(8), signed=True)


@cache
def _server():
    """Start the process that forks, once, and return the connection to it."""
    ours, theirs = socket.socketpair()
    code = f"import sys; sys.path.insert(1, {str(Path(__file__).parent)!r}); from forked_commands import serve; serve()"
    process = subprocess.Popen([sys.executable, "-c", code], stdin=theirs)
    theirs.close()
    atexit.register(lambda: (ours.close(), process.wait()))
    return ours


def serve():
    """Run commands until the connection on standard input is closed."""
    rmpc_bench = import_module("rmpc_bench")
    own = (each.name for each in pkgutil.walk_packages(rmpc_bench.__path__, "rmpc_bench."))
    for name in (*LIBRARIES, *own):
        if not name.startswith(OPTIONAL):
            import_module(name)
    gc.freeze()
    connection = socket.socket(fileno=os.dup(0))
    while True:
        length, streams, _, _ = socket.recv_fds(connection, 8, 3)
        if not length:
            return
        request = json.loads(connection.recv(int.from_bytes(length), socket.MSG_WAITALL))
        child = os.fork()
        if child == 0:
            connection.close()
            _command(request, streams)
        for stream in streams:
            os.close(stream)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        connection.sendall(code.to_bytes(8, signed=True))


def _command(request, streams):
    """Run a command in a fork, and end it as an interpreter ends, without taking its modules apart."""
    code = 1
    try:
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        os.environ.clear()
        os.environ.update(request["environ"])
        os.chdir(request["cwd"])
        sys.argv, sys.path[0] = request["argv"], request["cwd"]
        import_module("rmpc_bench.cli").main(prog_name="rmpc-bench")
    except SystemExit as end:
        code = end.code or 0
    except BaseException:
        traceback.print_exc()
    finally:
        threading._shutdown()
        atexit._run_exitfuncs()
        sys.stdout.flush(), sys.stderr.flush()
        os._exit(code)
