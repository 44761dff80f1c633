"""Which tests run: five turns of `.ci/run` run all of them, whatever marks and numbers of cases they have."""

from types import SimpleNamespace

import conftest
import pytest
from test_public_api import RUN


class Item:
    """A test with marks, as pytest collects it."""

    def __init__(self, nodeid, *marks):
        self.nodeid, self.marks = nodeid, marks

    def iter_markers(self):
        return iter(self.marks)


PAGES = [SimpleNamespace(name="page", args=(f"page {number}",)) for number in range(9)]
KILL, SLOW = (SimpleNamespace(name=name, args=()) for name in ("kill", "slow"))
TESTS = [Item(f"a::wide[{number}]") for number in range(13)]
TESTS += [Item(f"a::narrow[{number}]") for number in range(conftest.WIDE - 1)]
# The order of the cases differs from that of the pages.
TESTS += [Item(f"b::page[{number}]", PAGES[number]) for number in (3, 0, 1, 2, 4, 5, 6, 7, 8)]
TESTS += [Item(f"c::one[{number}]", PAGES[0]) for number in range(7)]
TESTS += [Item(f"d::mixed[{number}]", *[KILL] * (number % 3 == 0)) for number in range(11)]
TESTS += [Item(f"e::slow[{number}]", KILL, *[SLOW] * number) for number in range(2)]
TESTS += [Item(f"f::slow[{number}]", SLOW) for number in range(13)]


def chosen(monkeypatch, every, turn, *, marked=True, args=("tests",), markexpr="not slow and not perf"):
    """Return the tests that run."""
    for name, value in {"EVERY": every, "TURN": turn, "ALL": marked}.items():
        monkeypatch.setattr(conftest, name, value)
    left_out, items = [], [*TESTS]
    hook = SimpleNamespace(pytest_deselected=lambda items: left_out.extend(items))
    option = SimpleNamespace(markexpr=markexpr)
    conftest.pytest_collection_modifyitems(SimpleNamespace(args=args, option=option, hook=hook), items)
    assert [item for item in TESTS if item in items] == items
    assert {*items, *left_out} == {*TESTS} and len(items) + len(left_out) == len(TESTS)
    return {item.nodeid for item in items}


def test_five_turns_run_every_test(monkeypatch):
    """And the tests of a page together.  Trap: a case that its mark chooses in one turn and its number in another."""
    turns = [chosen(monkeypatch, 5, turn) for turn in range(7, 12)]
    assert set().union(*turns) == {item.nodeid for item in TESTS}
    for turn in turns:
        assert {"b::page[0]" in turn} == {f"c::one[{number}]" in turn for number in range(7)}
        assert "a::narrow[3]" in turn
        assert 2 <= sum(name.startswith("a::wide") for name in turn) <= 3


@pytest.mark.parametrize(
    ("args", "changed", "workers"),
    [
        (["tests/cli"], {}, "auto"),
        (RUN, {}, "auto"),
        (["tests"], {"markexpr": "slow"}, "auto"),
        (["tests"], {"numprocesses": 0}, 0),
        (["tests"], {"trace": True}, None),
        (["tests"], {"markexpr": "perf"}, None),
        (["tests/cli/test_run.py::test_a"], {}, None),
        (["tests/cli", "tests/test_language.py"], {}, None),
    ],
)
def test_named_files_and_measurements_run_in_one_process(args, changed, workers):
    """Times of two processes would depend on each other; a debugger needs one."""
    usual = {"numprocesses": None, "dist": "no", "trace": False, "markexpr": "not slow and not perf"}
    option = SimpleNamespace(**usual | changed)
    conftest.pytest_cmdline_main(SimpleNamespace(args=args, option=option))
    assert option.numprocesses == workers and (option.dist == "worksteal") == (workers == "auto")


def test_pytest_without_its_plugin_for_several_processes():
    without = SimpleNamespace(trace=False, markexpr="")
    conftest.pytest_cmdline_main(SimpleNamespace(args=["tests"], option=without))
    assert not hasattr(without, "numprocesses")


def test_without_marks_and_all_of_them(monkeypatch):
    default = chosen(monkeypatch, 10, 0, marked=False)
    assert not any(name.startswith(("b", "c", "e::slow[0]")) for name in default) and "a::wide[10]" in default
    # What `-m` leaves out is not there any more.
    asked = chosen(monkeypatch, 10, 0, marked=False, markexpr="slow")
    assert {"e::slow[1]", *(f"f::slow[{number}]" for number in range(13))} <= asked
    assert (
        chosen(monkeypatch, 1, 3)
        == chosen(monkeypatch, 10, 0, args=["tests/test_a.py"])
        == {item.nodeid for item in TESTS}
    )
