"""The audit hook of the battery stops what is forbidden, and lets an honest command do its work."""

import json
import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from received.audit import VARIABLE

HERE = Path(__file__).parent
PROGRAM = """
import ctypes, importlib.machinery, io, json, os, pickle, shutil, socket, sqlite3, subprocess, sys, tempfile, traceback
top, programs = sys.argv[1], json.loads(sys.argv[2])
def written(path):
    open(path, "w").close()
def log():
    try:
        return open(top + "/log").read()
    except FileNotFoundError:
        return ""
found = {}
for name, program in programs.items():
    outside, inside = (f"{top}/{name}/{each}" for each in ("outside", "inside"))
    before, errors = log(), os.open(f"{top}/tmp/{name}", os.O_RDWR | os.O_CREAT)
    child = os.fork()
    if child == 0:
        code = 1
        os.dup2(errors, 1), os.dup2(errors, 2)
        os.chdir(inside)
        try:
            exec(program)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    found[name] = [code, log()[len(before):], os.pread(errors, 100_000, 0).decode()]
print(json.dumps(found))
"""
"""Runs each program in a fork."""
FORBIDDEN = {
    "system": "os.system('true')",
    "execute": "os.execv('/bin/true', ['true'])",
    "spawn": "os.posix_spawn('/bin/true', ['true'], {})",
    "process": "subprocess.run(['true'])",
    "process-of-shell": "subprocess.run('true', shell=True)",
    "interpreter": "subprocess.run([sys.executable, '-c', 'pass'])",
    "interpreter-of-a-file": "subprocess.run([sys.executable, inside + '/evil.py'])",
    "git": "subprocess.run(['git', '-C', inside, 'status'])",
    "git-safe-but-from-elsewhere": "subprocess.run(['git', '--version'])",
    "import": "sys.path.insert(0, inside); importlib.import_module('evil')",
    "import-outside": "sys.path.insert(0, outside); importlib.import_module('evil')",
    "import-compiled": "importlib.machinery.ExtensionFileLoader('evil', inside + '/lib.so').create_module("
    "importlib.machinery.ModuleSpec('evil', None, origin=inside + '/lib.so'))",
    "run-file": "import runpy; runpy.run_path(inside + '/evil.py')",
    "compile": "compile('1', inside + '/evil.py', 'exec')",
    "library": "ctypes.CDLL(inside + '/lib.so')",
    "connect": "socket.socket().connect(('127.0.0.1', 9))",
    "bind": "socket.socket().bind(('127.0.0.1', 0))",
    "datagram": "socket.socket(type=socket.SOCK_DGRAM).sendto(b'', ('127.0.0.1', 9))",
    "address": "socket.getaddrinfo('localhost', 9)",
    "write": "written(outside + '/x')",
    "append": "open(outside + '/evil.py', 'a')",
    "change": "open(outside + '/evil.py', 'r+b')",
    "write-descriptor": "os.open(outside + '/x', os.O_CREAT | os.O_WRONLY)",
    "write-through-a-link": "written(inside + '/link')",
    "write-below-a-link": "written(inside + '/folder/x')",
    "write-relative": "os.chdir(inside); written('../outside/x')",
    "rename": "os.rename(inside + '/evil.py', outside + '/x')",
    "take": "os.replace(outside + '/evil.py', inside + '/x')",
    "remove": "os.remove(outside + '/evil.py')",
    "remove-tree": "shutil.rmtree(outside)",
    "remove-below-a-directory": "os.unlink('evil.py', dir_fd=os.open(outside, os.O_RDONLY))",
    "directory": "os.mkdir(outside + '/x')",
    "remove-directory": "os.rmdir(outside + '/empty')",
    "symbolic-link": "os.symlink('x', outside + '/x')",
    "hard-link": "os.link(inside + '/evil.py', outside + '/x')",
    "truncate": "os.truncate(outside + '/evil.py', 0)",
    "mode": "os.chmod(outside + '/evil.py', 0o777)",
    "times": "os.utime(outside + '/evil.py', (0, 0))",
    "database": "sqlite3.connect(outside + '/x.sqlite')",
    "database-by-name": "sqlite3.connect(f'file:{outside}/x.sqlite?mode=rwc', uri=True)",
    "extension": "sqlite3.connect(':memory:').enable_load_extension(True)",
    "pickle": "pickle.loads(b'cos\\nsystem\\n.')",
    "pickle-in-python": "pickle._loads(b'cposix\\nsystem\\n.')",
    "pickle-of-numpy": "import numpy; numpy.load(inside + '/evil.npy', allow_pickle=True)",
    "in-a-worker": "os.fork() or os.system('true'); os.wait()",
}
ALLOWED = {
    "write": "written(inside + '/x'); os.remove(inside + '/x')",
    "write-temporary": "tempfile.TemporaryFile().close(); tempfile.TemporaryDirectory().cleanup()",
    "write-nothing": "written(os.devnull)",
    "read": "open(outside + '/evil.py').read()",
    "read-database": "sqlite3.connect(f'file:{inside}/x.sqlite?mode=ro', uri=True)",
    "import": "import decimal, wsgiref.util, numpy, scipy.linalg",
    "text": "exec('x = 1'); from collections import namedtuple; namedtuple('A', 'b')",
    "library": "ctypes.CDLL(None)",
    "socket": "a, b = socket.socketpair(); a.sendall(b'1')",
    "pickle": "pickle.loads(pickle.dumps([1, 'a', {2: 3.0}]))",
}


IMPOSSIBLE = {
    "connect": "nobody listens",
    "import-compiled": "the library is a text",
    "library": "the library is a text",
}
"""Actions that fail where nothing stops them, because they would have an effect on the machine or need a library."""
if not hasattr(sqlite3.Connection, "enable_load_extension"):
    del FORBIDDEN["extension"]


def prepare(place):
    """A directory that may be written and one that may not, each with a program, and links from one to the other."""
    for name in ("inside", "outside"):
        (place / name).mkdir(parents=True)
        (place / name / "evil.py").write_text("mark = 1\n", encoding="utf-8")
        (place / name / "lib.so").write_bytes(b"\x7fELF")
    (place / "outside" / "empty").mkdir()
    (place / "inside" / "link").symlink_to("../outside/x")
    (place / "inside" / "folder").symlink_to("../outside")
    (place / "inside" / "x.sqlite").write_bytes(b"")
    with (place / "inside" / "evil.npy").open("wb") as file:
        header = {"descr": "|O", "fortran_order": False, "shape": (1,)}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(b"cos\nsystem\n.")


def seen(place):
    """Names, modes and contents of what nobody may change."""
    found = {path.name: path.lstat() for path in place.glob("outside/*")}
    return {name: (about.st_mode, about.st_size, about.st_mtime_ns) for name, about in found.items()}


def ran(top, programs, *, hook):
    """Run programs; return name -> exit code, what the hook has noted, errors, and whether something has changed."""
    (top / "tmp").mkdir()
    for name in programs:
        prepare(top / name)
    before = {name: seen(top / name) for name in programs}
    write = [str(top / "tmp"), *(f"{top}/{name}/inside" for name in programs)]
    policy = {"log": str(top / "log"), "write": write, "hostile": [str(top)]}
    given = json.dumps(policy if hook else {})
    environment = {**os.environ, "PYTHONPATH": str(HERE / "startup"), "TMPDIR": str(top / "tmp"), VARIABLE: given}
    words = [sys.executable, "-P", "-c", PROGRAM, str(top), json.dumps(programs)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return {name: (*each, before[name] != seen(top / name)) for name, each in json.loads(done.stdout).items()}


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """What happens to the forbidden actions under the hook."""
    return ran(tmp_path_factory.mktemp("stopped"), FORBIDDEN, hook=True)


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    """What happens to them where the hook has no policy."""
    return ran(tmp_path_factory.mktemp("free"), FORBIDDEN, hook=False)


@pytest.mark.parametrize("name", FORBIDDEN)
def test_a_forbidden_action_is_stopped_and_noted(name, stopped):
    code, noted, errors, changed = stopped[name]
    assert noted.count("\n") == 1, (noted, errors)
    assert name == "in-a-worker" or (code == 1 and "Forbidden" in errors), errors
    assert not changed


@pytest.mark.parametrize("name", FORBIDDEN)
def test_nothing_else_stops_it(name, free):
    """A row whose action fails by itself would prove nothing."""
    code, noted, errors, _ = free[name]
    assert noted == ""
    assert (name in IMPOSSIBLE) == bool(code), errors


def test_actions_that_are_allowed(tmp_path):
    for name, (code, noted, errors, changed) in ran(tmp_path, ALLOWED, hook=True).items():
        assert (code, noted, changed) == (0, "", False), (name, noted, errors)


def test_what_is_caught_is_noted_all_the_same(tmp_path):
    program = {"caught": "try:\n    os.system('true')\nexcept BaseException:\n    pass"}
    [(code, noted, _, _)] = ran(tmp_path, program, hook=True).values()
    assert code == 0 and noted.startswith("os.system:")
