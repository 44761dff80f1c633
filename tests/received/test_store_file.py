"""Files named trials.sqlite that are no trial store, or a damaged one: none of them is changed."""

import os
import re
import sqlite3
from contextlib import closing

import pytest
from small_experiment import cli, ran, write
from stored_rows import n_stored

from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.received.store import FILE, FORMAT, MissingError, check_file, is_in_use
from rmpc_bench.store.file import StoreFile
from rmpc_bench.store.store import Store

FIRST_FORMAT = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE trials (method TEXT, run INTEGER, status TEXT NOT NULL, PRIMARY KEY (method, run)) WITHOUT ROWID;
CREATE TABLE metrics (method TEXT, metric TEXT, run INTEGER, value REAL, PRIMARY KEY (method, metric, run));
CREATE TABLE uncertainty (draw TEXT, run INTEGER, name TEXT, value REAL NOT NULL, PRIMARY KEY (draw, run, name));
"""


def database(path, script):
    """Make a database."""
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(script)


def foreign(path):
    """Make a database of somebody else with a write-ahead log."""
    database(path, "PRAGMA journal_mode = WAL; CREATE TABLE meta (key, value); INSERT INTO meta VALUES ('mine', 1)")


def truncated(path):
    """Make a store and cut it in the middle."""
    with Store(path.parent):
        pass
    path.write_bytes(path.read_bytes()[:6000])


def of_next_format(path):
    """Make a store of a later version."""
    with Store(path.parent):
        pass
    database(path, f"PRAGMA user_version = {FORMAT + 1}")


def of_several_databases(path):
    """Make a store with a journal that names another file, which SQLite would delete."""
    with Store(path.parent):
        pass
    name = os.fsencode(path.parent.parent / "precious")
    numbers = len(name).to_bytes(4, "big") + sum(name).to_bytes(4, "big")
    end = name + numbers + bytes.fromhex("d9d505f920a163d7")
    path.with_name(f"{path.name}-journal").write_bytes(bytes.fromhex("d9d505f920a163d7") + bytes(2000) + end)


def with_a_log(path):
    """Make a store beside a write-ahead log, which SQLite would copy into it."""
    foreign(path.with_name("other"))
    with closing(sqlite3.connect(path.with_name("other"))) as other:
        other.execute("UPDATE meta SET value = 2")
        other.commit()
        log = path.with_name("other-wal").read_bytes()
    path.with_name("other").unlink()
    with Store(path.parent):
        pass
    path.with_name(f"{path.name}-wal").write_bytes(log)


def with_a_directory_as_log(path):
    """Make a store beside a directory, where SQLite would look for its log."""
    with Store(path.parent):
        pass
    path.with_name(f"{path.name}-wal").mkdir()


def with_a_journal_that_grows(path, page=4096):
    """Make a store with a journal that would restore it to 8.8 TB."""
    with Store(path.parent):
        pass
    numbers = b"".join(number.to_bytes(4, "big") for number in (0, 0, 2**31, 512, page))
    path.with_name(f"{path.name}-journal").write_bytes((bytes.fromhex("d9d505f920a163d7") + numbers).ljust(1024, b"\0"))


DAMAGED = {
    "zero bytes": lambda path: path.touch(),
    "garbage": lambda path: path.write_bytes(os.urandom(5000)),
    "header and garbage": lambda path: path.write_bytes(b"SQLite format 3\x00" + b"\xff" * 4096),
    "short": lambda path: path.write_bytes(b"SQLite"),
    "truncated": truncated,
    "directory": lambda path: path.mkdir(),
    "pipe": os.mkfifo,
    "dangling link": lambda path: path.symlink_to("nowhere"),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "another program": foreign,
    "first format": lambda path: database(path, FIRST_FORMAT),
    "next format": of_next_format,
    "journal of several databases": of_several_databases,
    "journal that grows": with_a_journal_that_grows,
    "journal without a page": lambda path: with_a_journal_that_grows(path, 0),
    "log": with_a_log,
    "directory as log": with_a_directory_as_log,
}


def content(path):
    """Bytes of a regular file, or what the name is instead."""
    if path.is_symlink():
        return os.readlink(path)
    return path.read_bytes() if path.is_file() else path.stat().st_mode


@pytest.mark.parametrize("kind", DAMAGED)
def test_fresh_works_on_any_file(tmp_path, kind):
    """The directory is renamed with everything in it, and the experiment runs."""
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "precious").touch()
    DAMAGED[kind](out / FILE)
    before = {each.name: content(each) for each in out.iterdir()}
    ran(write(tmp_path), out, "--fresh")
    [old] = tmp_path.glob("out.*")
    assert {each.name: content(each) for each in old.iterdir()} == before
    assert n_stored(out) == 12 and (tmp_path / "precious").exists()


@pytest.mark.parametrize("kind", [kind for kind in DAMAGED if kind not in ("zero bytes", "dangling link", "truncated")])
def test_other_commands_leave_the_file_as_it_is(tmp_path, kind):
    """They say in one sentence what it is; no traceback."""
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "precious").touch()
    DAMAGED[kind](out / FILE)
    before = {each.name: content(each) for each in out.iterdir()}
    path = write(tmp_path)
    for command in (("run", path, "-o", out), ("run", path, "-o", out, "-n"), ("report", out)):
        result = cli(*command)
        assert result.exit_code in (2, 5), result.output
        assert "trials.sqlite" in result.stderr and "--fresh" in result.stderr
        assert {each.name: content(each) for each in out.iterdir()} == before
    assert (tmp_path / "precious").exists()


def test_an_empty_file_is_a_new_store(tmp_path):
    """Reading it says that there is no trial; a run fills it."""
    (tmp_path / FILE).touch()
    with pytest.raises(MissingError, match="holds no trial"):
        Store(tmp_path, writable=False)
    with Store(tmp_path) as store:
        assert not store.has_trials("m")


def test_versions_are_named(tmp_path):
    """An earlier and a later format, with the way out."""
    database(tmp_path / FILE, FIRST_FORMAT)
    with pytest.raises(MissingError, match=re.escape("an earlier version of rmpc-bench has written it (format 1")):
        check_file(tmp_path / FILE, writable=False)
    (tmp_path / FILE).unlink()
    of_next_format(tmp_path / FILE)
    with pytest.raises(StoreError, match="a later version of rmpc-bench"):
        check_file(tmp_path / FILE, writable=True)


def test_a_file_that_may_not_be_read(tmp_path, monkeypatch):
    """The message says so; --fresh needs no permission for the file."""
    with Store(tmp_path):
        pass
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(StoreError, match="permission denied"):
        check_file(tmp_path / FILE, writable=True)
    assert not is_in_use(tmp_path)


def test_a_look_at_the_file_keeps_the_lock(tmp_path):
    """Closing a file drops the locks of its process on it, except where SQLite itself closes it."""
    import subprocess
    import sys

    code = "import sys; from pathlib import Path; from rmpc_bench.received.store import is_in_use"
    code += "; sys.exit(is_in_use(Path(sys.argv[1])))"
    with Store(tmp_path):
        check_file(tmp_path / FILE, writable=True)
        assert is_in_use(tmp_path)
        assert subprocess.run([sys.executable, "-c", code, tmp_path], check=False).returncode == 1
    assert not is_in_use(tmp_path)


def test_a_killed_first_transaction(tmp_path):
    """A store without tables gets them."""
    database(tmp_path / FILE, "PRAGMA application_id = 0x524D5043; PRAGMA user_version = 2; VACUUM")
    assert (tmp_path / FILE).stat().st_size > 0
    with Store(tmp_path) as store:
        store.set_meta("a", "b")
    assert StoreFile(tmp_path, writable=False).read("SELECT value FROM meta") == [("b",)]
