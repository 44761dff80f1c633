"""Hostile archives, directories and configurations: nothing of them runs, and every command ends as is promised.

`make test` runs every tenth case, as of all functions with many.  With `RMPC_BENCH_BATTERY=N` every N-th case is there,
and `RMPC_BENCH_BATTERY_SEED=N` draws other values and places of wrong types.
"""

import os
import sqlite3
from contextlib import closing

import pytest
from received import (
    honest,
    hostile_archives,
    hostile_configs,
    hostile_directories,
    hostile_records,
    hostile_stores,
)
from received.audited_commands import Server
from received.box import Box, check, each_of, verify

ROOMS = (hostile_archives, hostile_configs, hostile_directories, hostile_records, hostile_stores)
CASES = [case for room in ROOMS for case in room.CASES]
EVERY = int(os.environ.get("RMPC_BENCH_BATTERY", "1"))
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


def faults_of(commands, box, server):
    """Run commands; return what is wrong with them, each with its command."""
    found = []
    for command in commands:
        words = " ".join(str(each).replace(str(box.root), "") for each in command.words)
        _, faults = box.run(server, command)
        found += [f"{words} [{command.note}]: {fault}" for fault in faults]
    return found


@pytest.mark.parametrize("case", CASES[::EVERY], ids=lambda case: case.id)
def test_case(case, server, originals, tmp_path):
    """No command runs anything of it, writes outside what it names, ends in a traceback, or takes long."""
    box = Box(tmp_path, originals, case.id, SEED)
    found = faults_of(case.make(box), box, server)
    if found:
        pytest.fail("\n".join(found), pytrace=False)


def test_honest_files_pass(server, originals, tmp_path):
    """What the hook forbids is not needed: without it every case could pass because nothing works."""
    assert [each for each in originals.outcomes if each.code or each.stopped] == []
    box = Box(tmp_path, originals, "honest")
    commands = [each for name in ("plain", "tuned") for each in verify(originals.archive(name))]
    commands += verify(originals.archive("owned"))[:1]
    commands += check(originals.config("plain"))
    for name in honest.METHOD:
        verbs = "report status json pack show sites" if name != "owned" else "report status json sites"
        commands += each_of(box, box.results(name), f"{verbs} merge" if name == "shards" else verbs, name=name)
    found = faults_of([each._replace(codes=(0,)) for each in commands], box, server)
    different = each_of(box, box.here / "plain", "compare")
    found += faults_of([each._replace(codes=(1,)) for each in different], box, server)
    if found:
        pytest.fail("\n".join(found), pytrace=False)


def test_there_are_enough_cases_of_every_kind():
    assert len(CASES) >= 150 and len({case.id for case in CASES}) == len(CASES)
    assert {case.kind for case in CASES[::5]} == {case.kind for case in CASES}


@pytest.mark.parametrize("record", hostile_records.FIELDS)
def test_every_field_of_a_record_has_a_case(record, originals):
    """A field that is new in the records must be tried, too."""
    data = hostile_records.load(originals.directory(hostile_records.EXPERIMENT.get(record, "plain")), record)
    assert {*data} <= {*hostile_records.FIELDS[record]}
    if record == hostile_records.LAYOUT:
        assert {*data["points"][0]} <= {*hostile_records.POINT}


def test_every_column_of_the_store_has_a_case(originals):
    with closing(sqlite3.connect(originals.directory("plain") / "trials.sqlite")) as connection:
        tables = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        found = {name: tuple(row[1] for row in connection.execute(f"PRAGMA table_info({name})")) for name in tables}
    assert found == hostile_stores.COLUMNS
