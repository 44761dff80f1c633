"""Hostile archives, directories and configurations: nothing of them runs, and every command ends as is promised.

By default every fifth case runs.  `RMPC_BENCH_BATTERY=all` runs all of them, and `RMPC_BENCH_BATTERY_SEED=N` draws other
values for the fields that have a wrong type.
"""

import os

import pytest
from received import hostile_archives, hostile_configs, hostile_directories, hostile_records, hostile_stores, honest
from received.audited_commands import Server
from received.box import Box

CASES = [
    *hostile_archives.CASES,
    *hostile_configs.CASES,
    *hostile_directories.CASES,
    *hostile_records.CASES,
    *hostile_stores.CASES,
]
EVERY = 1 if os.environ.get("RMPC_BENCH_BATTERY") == "all" else 5
SEED = int(os.environ.get("RMPC_BENCH_BATTERY_SEED", "0"))


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    """The process that forks."""
    made = Server(tmp_path_factory.mktemp("server"))
    yield made
    made.close()


@pytest.fixture(scope="session")
def originals(server, tmp_path_factory):
    """Honest results."""
    return honest.make(server, tmp_path_factory.mktemp("honest") / "made")


@pytest.mark.parametrize("case", CASES[::EVERY], ids=lambda case: case.id)
def test_case(case, server, originals, tmp_path):
    """No command runs anything of it, writes outside what it names, ends in a traceback, or takes long."""
    box = Box(tmp_path, originals, case.id, SEED)
    found = []
    for command in case.make(box):
        outcome, faults = box.run(server, command)
        words = " ".join(str(each).replace(str(tmp_path), "") for each in command.words)
        found += [f"{words} [{command.note}]: {fault}" for fault in faults]
    if found:
        pytest.fail("\n".join(found), pytrace=False)
