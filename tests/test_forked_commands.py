"""A command in a fork is what it is in a process of its own: exit code, output, messages, directory, environment."""

import subprocess
import sys

import forked_commands
from small_experiment import write


def test_it_is_the_same_as_in_a_new_interpreter(tmp_path, monkeypatch):
    write(tmp_path)
    (tmp_path / "own.py").write_text("raise SystemExit(9)\n", encoding="utf-8")
    monkeypatch.setenv("COLUMNS", "60")
    for arguments in (["check", "tiny.yaml"], ["check", "none.yaml"], ["run", "--none"], ["describe", "own.py:Any"]):
        forked = forked_commands.run(arguments, tmp_path)
        command = [sys.executable, "-m", "rmpc_bench", *arguments]
        new = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (forked.returncode, forked.stdout, forked.stderr) == (new.returncode, new.stdout, new.stderr)
