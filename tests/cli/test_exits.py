"""From an exception to an exit code and a line."""

import signal
import sys

import click
import pytest

from rmpc_bench.cli import exits
from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.received.store import WriteError
from rmpc_bench.types import ConfigError, Problem


@pytest.fixture(autouse=True)
def handlers():
    """Give signals their handlers back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def code_of(outcome, name="run"):
    """Exit code of a verb that returns or raises something."""

    def verb():
        """Do it."""
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    verb.__name__ = name
    with pytest.raises(SystemExit) as caught:
        exits.guarded(verb)()
    return caught.value.code


@pytest.mark.parametrize(
    ("outcome", "code", "text"),
    [
        (None, 0, ""),
        (3, 3, ""),
        (ConfigError([Problem("f.yaml", 2, 3, "seed", "wrong")]), 2, "f.yaml:2:3: seed: wrong"),
        (StoreError("another experiment"), 5, "another experiment"),
        (WriteError("disk full"), 74, "results cannot be written: disk full"),
        (OSError(28, "No space left on device"), 74, "No space left on device"),
        (FileExistsError(17, "File exists", "out"), 2, "out: a file is in the place of this directory"),
        (FileExistsError("no name is known"), 74, "no name is known"),
        (KeyboardInterrupt(), 130, "interrupted; finished blocks are stored, the same command continues"),
        (exits.Terminated(), 143, "terminated; finished blocks are stored, the same command continues"),
        (ZeroDivisionError("bug"), 70, "please report it"),
    ],
)
def test_exit_codes(capsys, outcome, code, text):
    """Those of product.md section 3; a traceback for bugs only."""
    assert code_of(outcome) == code
    captured = capsys.readouterr()
    assert captured.out == "" and text in captured.err
    assert ("Traceback" in captured.err) == (code == 70)


@pytest.mark.parametrize("outcome", [KeyboardInterrupt(), exits.Terminated()])
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("check", "this command changes no results"),
        ("list_", "this command changes no results"),
        ("report", "stored trials are unchanged, the same command writes the report again"),
        ("merge", "the shards are unchanged, the same command joins them again"),
        ("pack", "the results are unchanged, the same command packs them again"),
        ("verify", "nothing was verified, the same command starts again"),
    ],
)
def test_what_an_interrupted_command_leaves(capsys, outcome, name, text):
    """A command that stores no block does not speak of blocks."""
    code_of(outcome, name)
    assert capsys.readouterr().err.partition("; ")[2].strip() == text


def test_wrong_usage_is_clicks_own(monkeypatch):
    """It shows the usage line and exits with 2."""

    @exits.guarded
    def verb():
        raise click.BadParameter("no")

    with pytest.raises(click.BadParameter):
        verb()


@pytest.mark.parametrize(("outcome", "code"), [(KeyboardInterrupt(), 130), (exits.Terminated(), 143)])
def test_an_interrupted_import_is_not_begun_again(monkeypatch, outcome, code):
    """Ctrl-C while modules load leaves some of them broken; saying so must need none of them."""
    for name in [name for name in sys.modules if name.startswith(("rmpc_bench.config", "rmpc_bench.types", "numpy"))]:
        monkeypatch.setitem(sys.modules, name, None)
    assert code_of(outcome) == code


def test_a_signal_becomes_an_exit_code(capsys):
    """SIGTERM, which Python does not turn into an exception by itself."""

    @exits.guarded
    def verb():
        signal.raise_signal(signal.SIGTERM)

    with pytest.raises(SystemExit) as caught:
        verb()
    assert caught.value.code == 143
