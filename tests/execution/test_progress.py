"""What the screen shows; all of it on stderr."""

import threading

import pytest

from rmpc_bench.execution.progress import Bar, Plain, Silent, choose, said_if_slow


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


def test_silent_still_warns(capsys):
    """Only what must be said."""
    shown = Silent()
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


@pytest.mark.parametrize(("how", "kind"), [("bar", Bar), ("plain", Plain), ("none", Silent)])
def test_choose_by_name(how, kind):
    """Each word has its display."""
    assert type(choose(how)) is kind


@pytest.mark.parametrize(("terminal", "kind"), [(True, Bar), (False, Plain)])
def test_choose_by_the_terminal(monkeypatch, terminal, kind):
    """A log gets lines, a terminal a bar."""
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal)
    assert type(choose("auto")) is kind


class Heard(Silent):
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
