"""A forked worker is what a process of its own is: child, open files, directory, environment, arguments, exit code."""

import json
import os
import subprocess
import sys

import forked_workers
import pytest

PROBE = """
import json, os, sys


def main(parent, kept):
    found = {"parent": os.getppid() == parent, "files": sorted(map(int, os.listdir("/proc/self/fd")))[:-1]}
    found |= {"directory": os.getcwd(), "path": sys.path, "argument": sys.argv[1], "group": os.getpgid(0)}
    found |= {"variables": dict(os.environ), "session": os.getsid(0) == os.getpid(), "read": sys.stdin.read()}
    os.write(kept, b"kept")
    print(json.dumps(found))
    sys.stderr.write("said")
    os._exit(3)
"""


@pytest.fixture
def probe(tmp_path, monkeypatch):
    """A module that says what its process is."""
    (tmp_path / "probe_of_workers.py").write_text(PROBE, encoding="utf-8")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *(entry or os.getcwd() for entry in dict.fromkeys(sys.path))])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(forked_workers, "MODULES", {"probe_of_workers", "missing_of_workers"})
    return "probe_of_workers"


pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="no process can adopt another one")


@pytest.mark.parametrize("session", [False, True])
def test_it_is_the_same_as_in_a_new_interpreter(probe, session):
    found = []
    for start in (forked_workers._start, forked_workers.Forks.start):
        reading, writing = os.pipe()
        given = {"parent": os.getpid(), "kept": writing}
        keys = {"given": given, "inherited": [writing], "session": session}
        with start(probe, subprocess.PIPE, subprocess.PIPE, subprocess.PIPE, **keys) as process:
            os.close(writing)
            out, err = process.communicate(b"asked", 60.0)
        kept = os.read(reading, 8)
        os.close(reading)
        answer = json.loads(out)
        # A group of its own has its own number.
        assert (answer.pop("group") == process.pid) == session
        argument, names = json.loads(answer.pop("argument")), answer.pop("variables")
        names.pop("_", None), names.pop("LC_CTYPE", None)
        answer["files"] = len(answer["files"])
        argument[1].pop("kept")
        found.append((answer, argument, names, err, kept, process.returncode))
        with pytest.raises(ChildProcessError):
            os.waitpid(process.pid, os.WNOHANG)
    assert found[0] == found[1] and found[0][0]["read"] == "asked"


def test_an_error_has_its_traceback_and_a_kill_its_signal(probe):
    given = {"parent": os.getpid()}
    nothing = subprocess.DEVNULL
    with forked_workers._start("missing_of_workers", nothing, nothing, subprocess.PIPE, given=given) as process:
        assert b"ModuleNotFoundError: No module named 'missing_of_workers'" in process.communicate(timeout=60.0)[1]
    assert process.returncode == 1
    with forked_workers._start(probe, subprocess.PIPE, nothing, nothing, given=given | {"kept": 2}) as process:
        process.kill()
    assert process.returncode == -9
