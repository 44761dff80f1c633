"""An audit hook that notes, and stops, what a file from somebody else must not make a command do.

`startup/sitecustomize.py` installs it before the bench is imported: in the process that forks for every command, and in
the workers that a command starts.  It does nothing until it has a policy.  What it stops is noted in a file as well,
because a command may catch the exception.

It imports no module of the bench or of the tests.
"""

import json
import os
import socket
import sys
import sysconfig
import threading
from urllib.parse import parse_qs, unquote, urlsplit

VARIABLE = "RMPC_BENCH_TEST_AUDIT"
"""Environment variable with the policy as JSON; `{}` for none yet."""
HERE = os.path.dirname(os.path.realpath(__file__))
PROJECT = os.path.join(os.path.dirname(os.path.dirname(HERE)), "rmpc_bench")
INSTALLED = tuple(
    dict.fromkeys(
        os.path.realpath(each)
        for each in (sys.prefix, sys.base_prefix, *sysconfig.get_paths().values(), PROJECT, HERE)
        if each
    )
)
"""Directories of the interpreter, of the installed packages and of the project: their code may run."""
SYSTEM = ("/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib", "/System", "/opt/homebrew")
"""Directories of shared libraries of the system."""
SENT = tuple(
    os.path.join(*each.split("/"))
    for each in (
        "rmpc_bench/components/transport.py",
        "rmpc_bench/conformance/subject.py",
        "rmpc_bench/conformance/information.py",
        "rmpc_bench/engines/messages.py",
        "rmpc_bench/engines/worker.py",
        "rmpc_bench/execution/separation.py",
        "multiprocessing/connection.py",
        "numba/core/caching.py",
        "numba/core/serialize.py",
        "numba/cloudpickle/cloudpickle.py",
        "cloudpickle/cloudpickle.py",
    )
)
"""Modules that unpickle what another process of the command has sent, or what numba has compiled for the package."""
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
NEVER = (
    *("os.exec", "os.posix_spawn", "os.spawn", "os.system", "os.startfile", "os.startfile/2", "pty.spawn"),
    *("sqlite3.load_extension", "webbrowser.open", "urllib.Request"),
    *("socket.getaddrinfo", "socket.gethostbyname", "socket.gethostbyaddr"),
)
"""Events that no command causes."""


class Forbidden(RuntimeError):
    """What the policy forbids."""


class Policy:
    """What a process may do.

    Parameters
    ----------
    log : file that gets a line for everything that is stopped
    write : directories and files that may be written
    hostile : directories whose code never runs, wherever they lie
    code : files of these that the user has allowed
    git : whether git may be started in any way, in a repository of the user
    """

    def __init__(self, log, write=(), hostile=(), code=(), git=False):
        self.log = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        self.write = tuple(map(os.path.realpath, write))
        self.hostile = tuple(map(os.path.realpath, hostile))
        self.code = tuple(map(os.path.realpath, code))
        self.git = git
        self.known = {}


_policy = None
_inside = set()
"""Threads that are in the hook: what it does itself is not checked."""


def install(text):
    """Install the hook in this process, with the policy of the environment variable."""
    if given := json.loads(text):
        arm(**given)
    sys.addaudithook(_hook)


def arm(**policy):
    """Set the policy of this process and of the processes that it starts."""
    global _policy
    os.environ[VARIABLE] = json.dumps(policy)
    _policy = Policy(**policy)


def disarm():
    """Forbid nothing any more in this process."""
    global _policy
    os.environ[VARIABLE], _policy = "{}", None


def _hook(event, arguments):
    rule = RULES.get(event)
    thread = threading.get_ident()
    if rule is None or _policy is None or thread in _inside:
        return
    _inside.add(thread)
    try:
        reason = rule(*arguments)
        if reason:
            os.write(_policy.log, f"{event}: {reason}\n".encode(errors="backslashreplace"))
    finally:
        _inside.discard(thread)
    if reason:
        raise Forbidden(f"{event}: {reason}")


def _never(*arguments):
    return " ".join(map(repr, arguments))[:300]


def _below(path, roots):
    return any(path == root or path.startswith(root.rstrip(os.sep) + os.sep) for root in roots)


def _directory_of(number):
    return os.readlink(f"/proc/self/fd/{number}") if isinstance(number, int) and number >= 0 else os.getcwd()


def _unwritable(path, directory=-1, *, follow=False):
    """Say that a path may not be written; the last part is a link itself unless it is followed."""
    if isinstance(path, int):
        path = _directory_of(path)
    text = os.path.join(_directory_of(directory), os.fsdecode(path))
    parent, name = os.path.split(text.rstrip(os.sep))
    place = os.path.realpath(text) if follow else os.path.join(os.path.realpath(parent), name)
    compiled = "__pycache__" in place.split(os.sep) and _below(place, INSTALLED)
    if place == os.devnull or compiled or _below(place, _policy.write):
        return ""
    return f"writes {place}"


def _open(path, mode, flags):
    if path is None or isinstance(path, int) or not (flags or 0) & WRITING:
        return ""
    return _unwritable(path, follow=True)


def _two(source, target, source_directory=-1, target_directory=-1):
    return _unwritable(source, source_directory) or _unwritable(target, target_directory)


def _linked(source, target, *directories):
    return _unwritable(target, directories[-1] if directories else -1)


def _changed(path, *rest):
    """Mode, owner and times: the last argument is the directory to which the path is relative."""
    return _unwritable(path, rest[-1], follow=True)


def _foreign(filename):
    """Say that a file has code of somebody else; empty for installed code."""
    if filename not in _policy.known:
        place = os.path.realpath(filename)
        allowed = _below(place, _policy.code) or (_below(place, INSTALLED) and not _below(place, _policy.hostile))
        _policy.known[filename] = "" if allowed else f"runs {place}"
    return _policy.known[filename]


def _callers():
    """Files of the functions that are running, the last one first."""
    frame = sys._getframe(1)
    while frame is not None:
        name = frame.f_code.co_filename
        if name != __file__ and not name.startswith("<"):
            yield name
        frame = frame.f_back


def _code(filename):
    """Text that is no file is the matter of the function that compiles it."""
    name = os.fsdecode(filename) if isinstance(filename, str | bytes | os.PathLike) else "<text>"
    if name.startswith("<") and name.endswith(">"):
        name = next(_callers(), "")
    return _foreign(name) if name else ""


def _exec(code):
    return _code(getattr(code, "co_filename", "<text>"))


def _compile(source, filename):
    return _code(filename)


def _import(module, filename, *rest):
    return _foreign(filename) if filename else ""


def _library(name, *rest):
    """Shared libraries of the interpreter, the packages and the system."""
    name = getattr(name, "_name", name)
    if name is None or isinstance(name, int) or os.sep not in os.fsdecode(name):
        return ""
    name = os.fsdecode(name)
    return "" if _below(name, SYSTEM) or _below(os.path.realpath(name), SYSTEM) else _foreign(name)


def _pickled(module, name):
    """What a pickle names is imported: the bench reads pickles of its own processes only."""
    caller = next((each for each in _callers() if os.path.basename(each) != "pickle.py"), "")
    return "" if caller.endswith(SENT) else f"unpickles {module}.{name} in {caller}"


def _address(connection, address):
    return "" if connection.family == getattr(socket, "AF_UNIX", None) else f"{address!r}"


def _database(name):
    text = os.fsdecode(name)
    if text == ":memory:":
        return ""
    if text.startswith("file:"):
        parts = urlsplit(text)
        text, options = unquote(parts.path), parse_qs(parts.query)
        if options.get("mode") == ["ro"] or options.get("mode") == ["memory"]:
            return ""
    return _unwritable(text, follow=True)


def _extension(connection, enabled):
    return "loads an extension" if enabled else ""


def _process(executable, arguments, directory, environment):
    """The interpreter with a program of the bench, or git that reads no setting of a repository."""
    words = [os.fsdecode(each) for each in ([arguments] if isinstance(arguments, str | bytes) else arguments)]
    called = " ".join(words)[:300]
    caller = next((each for each in _callers() if not each.endswith("subprocess.py")), "")
    if not _below(os.path.realpath(caller), (PROJECT,)):
        return f"{caller} starts {called}"
    if os.path.basename(words[0]) == "git":
        return _git(words, directory, environment or os.environ)
    program = words[words.index("-c") + 1] if "-c" in words[:-1] else ""
    own = words[0] == sys.executable == os.fsdecode(executable) and "rmpc_bench." in program and "-P" in words
    return "" if own else f"starts {called}"


def _git(words, directory, environment):
    """Refuse git with the configuration, the hooks or the monitor of a repository, or in an archive taken out."""
    if _policy.git:
        return ""
    called = " ".join(words)
    own = [each.partition("=")[2] for each in words if each.startswith("--git-dir=")]
    tree = [each.partition("=")[2] for each in words if each.startswith("--work-tree=")]
    safe = (
        own
        and _below(os.path.realpath(own[0]), (os.path.realpath(os.environ.get("TMPDIR", "/tmp")),))
        and "core.fsmonitor=false" in words
        and any(each.startswith("core.hooksPath=") for each in words)
        and all(environment.get(f"GIT_CONFIG_{each}") == os.devnull for each in ("GLOBAL", "SYSTEM"))
    )
    if not safe:
        return f"starts git in a repository: {called[:300]}"
    place = tree[0] if tree else directory or os.getcwd()
    packed = os.path.exists(os.path.join(place, "ro-crate-metadata.json"))
    return f"starts git in an archive: {called[:300]}" if packed else ""


RULES = dict.fromkeys(NEVER, _never) | {
    "open": _open,
    "os.remove": _unwritable,
    "os.rmdir": _unwritable,
    "os.mkdir": lambda path, mode, directory=-1: _unwritable(path, directory),
    "os.rename": _two,
    "os.symlink": _linked,
    "os.link": _linked,
    "os.truncate": lambda path, length: _unwritable(path, follow=True),
    "os.chmod": _changed,
    "os.chown": _changed,
    "os.utime": _changed,
    "os.setxattr": lambda path, *rest: _unwritable(path, follow=True),
    "compile": _compile,
    "exec": _exec,
    "import": _import,
    "ctypes.dlopen": _library,
    "ctypes.dlsym": _library,
    "pickle.find_class": _pickled,
    "socket.connect": _address,
    "socket.bind": _address,
    "socket.sendto": _address,
    "sqlite3.connect": _database,
    "sqlite3.enable_load_extension": _extension,
    "subprocess.Popen": _process,
}
