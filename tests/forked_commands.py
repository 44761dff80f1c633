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
        code = ask([each.fileno() for each in (nothing, out, err)], argv=command, cwd=str(cwd))
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
    return ask([0, 1, 2], connection, argv=["rmpc-bench", *arguments])


def ask(files, connection=None, **keys):
    """Return the answer of the process that forks to a request with these open files, a number."""
    connection = connection or _server()
    request = json.dumps({"cwd": os.getcwd(), "environ": dict(os.environ), **keys}).encode()
    socket.send_fds(connection, [len(request).to_bytes(8)], files)
    connection.sendall(request)
    answer = connection.recv(8)
    if not answer:
        raise ConnectionError("the process that forks has ended")
    return int.from_bytes(answer, signed=True)


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
    """Run commands and start workers until the connection on standard input is closed."""
    # Here, since the first one needs this module, and the other one imports much.
    import forked_workers
    import small_experiment

    rmpc_bench = import_module("rmpc_bench")
    own = (each.name for each in pkgutil.walk_packages(rmpc_bench.__path__, "rmpc_bench."))
    for name in (*LIBRARIES, *own):
        if not name.startswith(OPTIONAL):
            import_module(name)
    with tempfile.TemporaryDirectory() as place:
        # Compiled code that most experiments need is loaded once.
        rmpc_bench.run(small_experiment.write(Path(place)), directory=place, progress=False)
    gc.freeze()
    connection = socket.socket(fileno=os.dup(0))
    while True:
        length, files, _, _ = socket.recv_fds(connection, 8, 16)
        if not length:
            return
        request = json.loads(connection.recv(int.from_bytes(length), socket.MSG_WAITALL))
        answer = forked_workers.fork(request, files) if "given" in request else _ended(request, files, connection)
        for file in files:
            os.close(file)
        connection.sendall(answer.to_bytes(8, signed=True))


def _ended(request, streams, connection):
    """Run a command in a fork and return its exit code."""
    child = os.fork()
    if child == 0:
        connection.close()
        _command(request, streams)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


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
