"""Rows of a trial store, counted and changed behind its back."""

import sqlite3
from contextlib import closing

import numpy as np

from rmpc_bench.store.store import Store

_COLUMNS = (
    "SELECT columns.number FROM columns JOIN keys ON keys.number = columns.owner WHERE kind LIKE ? AND key LIKE ?"
)


def n_stored(directory):
    """Count the trials of all methods in a store that must be sound."""
    query = "SELECT DISTINCT key FROM columns JOIN keys ON keys.number = owner WHERE kind = 'status'"
    with Store(directory, writable=False) as store:
        assert store.file.read("PRAGMA integrity_check") == [("ok",)]
        return sum(len(store.statuses(key, 10**6)[0]) for (key,) in store.file.read(query))


def forget(directory, method):
    """Remove statuses and metrics of a method."""
    with closing(sqlite3.connect(directory / "trials.sqlite")) as connection, connection:
        connection.execute(f"DELETE FROM chunks WHERE column IN ({_COLUMNS})", ("%", method))


def change(directory, kind, function):
    """Replace all numbers of the columns of a kind, `metric` or `uncertainty`."""
    with closing(sqlite3.connect(directory / "trials.sqlite")) as connection, connection:
        rows = connection.execute(
            f"SELECT data, column, number FROM chunks WHERE column IN ({_COLUMNS})", (kind, "%")
        ).fetchall()
        changed = [(function(np.frombuffer(data)).tobytes(), *where) for data, *where in rows]
        connection.executemany("UPDATE chunks SET data = ? WHERE column = ? AND number = ?", changed)
