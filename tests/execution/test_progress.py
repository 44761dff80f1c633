"""What the screen shows; all of it on stderr."""

import json
import re
import threading

import numpy as np
import pytest

from rmpc_bench.analysis.intervals import student
from rmpc_bench.execution.progress import Bar, JsonLines, Plain, Progress, choose, said_if_slow
from rmpc_bench.results.running import RunningComparison
from rmpc_bench.types import MetricInfo


class Clock:
    """Seconds that pass when told."""

    now = 100.0

    def __call__(self):
        return self.now


def test_plain_says_a_line_now_and_then(capsys):
    """A line at the start, then one every few seconds with the time left at the rate since the start."""
    clock = Clock()
    shown = Plain(seconds=5.0, clock=clock)
    shown.start("fig7", 100, 20)
    for seconds in (4.0, 1.0, 4.9, 0.1):
        clock.now += seconds
        shown.advance(10)
    shown.stop()
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        "fig7: 100 trials, 20 stored already",
        "fig7: 40 of 100 trials, 15 s left",
        "fig7: 60 of 100 trials, 10 s left",
    ]


def test_plain_without_anything_stored(capsys):
    """Nothing is said of what is not there, and no time is no division by zero."""
    shown = Plain(seconds=0.0, clock=Clock())
    shown.start("fig7", 2, 0)
    shown.advance(2)
    assert capsys.readouterr().err.splitlines() == ["fig7: 2 trials", "fig7: 2 of 2 trials, 0 s left"]


def test_the_time_left_is_that_of_computed_trials(capsys):
    """What an earlier session has stored counts as done and not for the rate; before that no time is shown."""
    clock = Clock()
    shown = Plain(seconds=0.0, clock=clock)
    shown.start("tuning", 100, 0)
    shown.found(40)
    clock.now += 5.0
    shown.advance(0)
    clock.now += 5.0
    shown.advance(20)
    assert capsys.readouterr().err.splitlines() == [
        "tuning: 100 trials",
        "tuning: 40 of 100 trials",
        "tuning: 60 of 100 trials, 20 s left",
    ]


def test_json_lines_have_no_time_before_a_trial_is_computed(capsys):
    clock = Clock()
    shown = JsonLines(seconds=0.0, clock=clock)
    shown.start("tuning", 10, 0)
    shown.found(5)
    shown.advance(0)
    clock.now += 2.0
    shown.advance(1)
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [(line["done"], line.get("left_seconds", "")) for line in lines] == [(0, ""), (5, None), (6, 8.0)]


def test_silent_still_warns(capsys):
    """Only what must be said."""
    shown = Progress()
    shown.start("fig7", 10, 0)
    shown.advance(10)
    shown.say("careful")
    shown.stop()
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "careful\n")


def test_bar_without_a_terminal(capsys):
    """It writes nothing to stdout, keeps brackets in what it says, and ends."""
    shown = Bar()
    shown.start("fig7", 10, 4)
    shown.advance(6)
    shown.say("a [bracket]")
    shown.stop()
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "a [bracket]" in captured.err


def test_bar_on_a_terminal(capsys, monkeypatch):
    """The title is text, whatever brackets it contains."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    shown = Bar()
    shown.start("fig[red]7", 10, 4)
    shown.advance(6)
    shown.stop()
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "fig[red]7 [trials]" in captured.err and "10/10" in captured.err


@pytest.mark.parametrize(("how", "kind"), [("bar", Bar), ("plain", Plain), ("json", JsonLines), ("none", Progress)])
def test_choose_by_name(how, kind):
    """Each word has its display."""
    assert type(choose(how)) is kind


@pytest.mark.parametrize(("terminal", "kind"), [(True, Bar), (False, Plain)])
def test_choose_by_the_terminal(monkeypatch, terminal, kind):
    """A log gets lines, a terminal a bar."""
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal)
    monkeypatch.setenv("TERM", "xterm")
    assert type(choose("auto")) is kind


class Heard(Progress):
    """Remembers what was said, and tells a waiting thread."""

    def __init__(self):
        self.said, self.spoken = [], threading.Event()

    def say(self, text):
        self.said.append(text)
        self.spoken.set()


def test_said_if_slow():
    """Work that takes longer is explained while it goes on."""
    heard = Heard()
    with said_if_slow(heard, "compiling", seconds=0.0):
        assert heard.spoken.wait(timeout=10.0)
    assert heard.said == ["compiling"]


def test_not_said_if_fast():
    """Fast work is not, not even later, nor when it fails."""
    heard = Heard()
    before = threading.active_count()
    with pytest.raises(RuntimeError), said_if_slow(heard, "compiling", seconds=30.0):
        raise RuntimeError
    for thread in threading.enumerate():
        if isinstance(thread, threading.Timer):
            thread.join(timeout=10.0)
    assert heard.said == [] and threading.active_count() <= before


def comparison():
    """Four runs of two methods; one method is 10 % better."""
    running = RunningComparison(MetricInfo("mse", "rad^2", "lower"), [("", {"A": "a", "B": "b"})], "A", 0.95)
    running.add("a", range(4), np.array([1.0, 1.0, 1.0, 1.0]), np.zeros(4))
    running.add("b", range(4), np.array([0.89, 0.9, 0.91, 0.88]), np.zeros(4))
    return running


def test_plain_has_the_comparison_so_far(capsys):
    """A long computation shows where it goes."""
    shown = Plain(seconds=0.0, clock=Clock())
    shown.start("fig7", 8, 0, comparison())
    shown.advance(8)
    assert capsys.readouterr().err.splitlines()[1] == (
        "fig7: 8 of 8 trials, 0 s left; mse vs A: B -10.5 % [-12.5, -8.4]"
    )


def test_more_trials_may_follow(capsys):
    """A stopping rule adds the runs of the next look."""
    shown = Plain(seconds=0.0, clock=Clock())
    shown.start("fig7", 8, 0)
    shown.extend(8)
    shown.advance(4)
    assert "4 of 16 trials" in capsys.readouterr().err


def test_json_lines(capsys):
    """Every line is an object with numbers that JSON has."""
    clock = Clock()
    shown = JsonLines(seconds=1.0, clock=clock)
    empty = RunningComparison(MetricInfo("mse", "", "lower"), [("", {"A": "a", "B": "b"})], "A", 0.95)
    shown.start("fig7", 10, 2, empty)
    shown.advance(2)
    clock.now += 2.0
    shown.advance(2)
    shown.say("careful")
    shown.stop()
    captured = capsys.readouterr()
    lines = [json.loads(line, parse_constant=pytest.fail) for line in captured.err.splitlines()]
    assert captured.out == ""
    assert [line["event"] for line in lines] == ["start", "progress", "message", "stop"]
    assert [line.get("done") for line in lines] == [2, 6, None, 6]
    assert lines[0]["experiment"] == "fig7" and lines[0]["comparison"][0]["value"] is None
    assert lines[1] | {"comparison": []} == {
        "event": "progress", "done": 6, "trials": 10, "seconds": 2.0, "comparison": [], "left_seconds": 2.0
    }  # fmt: skip
    assert lines[2]["text"] == "careful"


def test_json_has_the_comparison(capsys):
    """Names and numbers of every method."""
    shown = JsonLines(seconds=0.0, clock=Clock())
    shown.start("fig7", 8, 0, comparison())
    (row,) = json.loads(capsys.readouterr().err)["comparison"]
    assert row["method"] == "B" and row["baseline"] == "A" and row["n"] == 4 and row["kind"] == "change"
    logs = np.log([0.89, 0.9, 0.91, 0.88])
    numbers = (row["value"], row["low"], row["high"])
    assert numbers == pytest.approx(100 * np.expm1([logs.mean(), *student(logs, 0.95)]), rel=1e-5)


@pytest.mark.parametrize("colour", [True, False])
def test_the_bar_has_no_colour_where_none_is_wanted(capsys, monkeypatch, colour):
    """NO_COLOR leaves bold and movements of the cursor, which are no colours."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    if not colour:
        monkeypatch.setenv("NO_COLOR", "1")
    shown = Bar()
    shown.start("fig7", 8, 0, comparison())
    shown.advance(8)
    shown.stop()
    captured = capsys.readouterr()
    assert "mse vs A: B -10.5 %" in captured.err
    assert bool(re.search(r"\x1b\[[\d;]*(3[0-7]|38;)[\d;]*m", captured.err)) == colour


def test_a_terminal_that_cannot_move_its_cursor_gets_lines(monkeypatch):
    """As in an editor's shell."""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "dumb")
    assert type(choose("auto")) is Plain
