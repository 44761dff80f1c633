"""What a file says reaches no terminal as a command to it: escapes of names and paths on both streams."""

import io
import subprocess
import sys

import pytest
from forked_commands import run
from small_experiment import write

from rmpc_bench.execution.progress import Bar

HOSTILE = "a\x1b]0;pwn\x07b\u202e"
SHOWN = "a\\x1b]0;pwn\\x07b\\u202e"


def test_a_message_shows_escapes(tmp_path):
    """The name of a file that does not exist."""
    found = run(["check", f"{HOSTILE}.yaml"], tmp_path)
    assert found.returncode == 2
    assert SHOWN in found.stderr and not {*"\x1b\x07\u202e"} & {*found.stderr}


def test_an_ascii_stream_is_filtered(tmp_path):
    """click writes to the buffer of one that is left as ASCII."""
    code = "import sys; from rmpc_bench.cli import main; main()"
    environment = {"PYTHONIOENCODING": "ascii", "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "-c", code, f"{HOSTILE}"]
    found = subprocess.run(command, capture_output=True, cwd=tmp_path, env=environment, check=False)
    assert found.returncode == 2
    assert SHOWN in found.stderr.decode() and b"\x1b" not in found.stderr


def test_a_bar_shows_escapes(monkeypatch):
    """Its own commands to the terminal pass, those of a title and a line do not."""
    stream = io.StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "200")
    bar = Bar()
    bar.start(HOSTILE, 3, 0)
    bar.say(HOSTILE)
    bar.stop()
    written = stream.getvalue()
    # rich itself leaves out the bell.
    assert SHOWN.replace("\\x07", "") in written and "\x1b[2K" in written
    assert "\x1b]" not in written and "\u202e" not in written


@pytest.mark.parametrize(
    "keys, message",
    [
        ({"methods": '{"a\\u202E": {estimator: {kind: kalman}}}'}, "contains the direction character U+202E"),
        ({"methods": '{"a\\e[2J": {estimator: {kind: kalman}}}'}, "contains the control character U+001B"),
        ({"methods": '{a: {estimator: {kind: kalman}}, "a\\u200B": {}}'}, "contains the invisible character U+200B"),
        ({"uncertainty": '{"e\\u2066": 1}'}, "contains the direction character U+2066"),
        ({"title": '"t\\e]0;t\\a"'}, "contains the control character U+001B"),
        ({"metrics": '[{kind: mse, name: "m\\x9B"}]'}, "contains the control character U+009B"),
    ],
)
def test_names_and_texts_of_a_configuration(tmp_path, keys, message):
    """All at once, each with its place."""
    path = write(tmp_path, **keys, paper='"p\\u061C"')
    found = run(["check", path.name], tmp_path)
    lines = [line for line in found.stderr.splitlines() if "leave it out" in line]
    assert found.returncode == 2 and len(lines) == 2
    assert any(message in line for line in lines)
    assert all(line.startswith(f"{path.name}:") for line in lines)
