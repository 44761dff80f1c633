"""Rows that other code has computed are kept apart, computed again and enter no table."""

import json
import sqlite3

import numpy as np
import pytest
from small_experiment import cli, ran, spied, write
from stored_rows import change, n_stored
from uncertain_experiment import write_estimation

import rmpc_bench
from rmpc_bench import load_config, load_results, load_trials
from rmpc_bench.received.store import MissingError


def change_code(monkeypatch, number):
    """Pretend that the bench computes other numbers; raising=False for code that knows no such number."""
    monkeypatch.setattr(rmpc_bench, "NUMERICS", number, raising=False)


def lines(result):
    """Return the lines of stderr about other code."""
    return [line for line in result.stderr.splitlines() if "other code" in line]


@pytest.fixture
def old(tmp_path, monkeypatch):
    """Return a configuration and a directory with six runs of two methods by code of NUMERICS 1; now it is 2."""
    change_code(monkeypatch, 1)
    path = write(tmp_path)
    ran(path, tmp_path / "out")
    change_code(monkeypatch, 2)
    return path, tmp_path / "out"


def test_no_table_mixes_rows_of_two_codes(old, monkeypatch):
    """More runs after a change of the code: the earlier ones are computed again, too."""
    path, out = old
    blocks = spied(monkeypatch)
    ran(path, out, "--runs", 10)
    assert sorted(blocks) == [("R-MPC", [*range(10)]), ("S-MPC", [*range(10)])]


def test_the_screen_says_what_is_computed_again(old, monkeypatch):
    """In one line, once; the directory is not refused."""
    path, out = old
    command = ("run", path, "-o", out, "-j", 1)
    result = cli(*command)
    assert result.exit_code == 0
    assert lines(result) == ["12 rows of other code (NUMERICS 1, here 2) are kept apart; they are computed again"]
    blocks = spied(monkeypatch)
    again = cli(*command)
    assert (again.exit_code, lines(again), blocks) == (0, [], [])


def test_old_rows_stay_under_their_keys(old, monkeypatch):
    """The earlier code finds its rows again, and computes nothing."""
    path, out = old
    ran(path, out)
    assert n_stored(out) == 24
    change_code(monkeypatch, 1)
    blocks = spied(monkeypatch)
    ran(path, out)
    assert blocks == []


def test_nothing_but_old_rows(old):
    """They are not read: `load_trials` and `report` say why and name the way out."""
    _, out = old
    message = "12 rows of other code (NUMERICS 1, here 2) are kept apart; no trial is stored; continue with"
    with pytest.raises(MissingError) as caught:
        load_trials(out)
    assert message in str(caught.value)
    result = cli("report", out)
    assert result.exit_code == 2 and message in result.stderr


def test_report_reads_current_rows_only(old):
    """With one method computed again: the other one is missing, and a line says why."""
    path, out = old
    assert lines(cli("run", path, "-o", out, "-j", 1, "--only", "S-MPC")) == [
        "6 rows of other code (NUMERICS 1, here 2) are kept apart; they are computed again",
        "6 rows of other code (NUMERICS 1, here 2) are kept apart; `rmpc-bench run` computes them again",
    ]
    result = cli("report", out)
    assert lines(result) == [
        "6 rows of other code (NUMERICS 1, here 2) are kept apart; `rmpc-bench run` computes them again"
    ]
    assert load_trials(out).methods == ("S-MPC",)
    assert not load_results(out).is_final


def test_a_dry_run_counts_them(old):
    """As trials to compute."""
    path, out = old
    result = cli("run", path, "-o", out, "-n")
    assert "12 of 12 trials to compute" in result.stdout
    assert "12 rows of other code (NUMERICS 1, here 2) are kept apart" in result.stdout


def test_rows_of_two_other_codes(old, monkeypatch):
    """Each run counts once; all numbers are named, later ones as well."""
    path, out = old
    ran(path, out)
    change_code(monkeypatch, 5)
    ran(path, out, "--runs", 2)
    change_code(monkeypatch, 4)
    result = cli("run", path, "-o", out, "-j", 1)
    assert lines(result) == ["12 rows of other code (NUMERICS 1, 2, 5, here 4) are kept apart; they are computed again"]


def test_all_that_trials_leave_is_kept_apart(tmp_path, monkeypatch):
    """Recorded runs, ensembles and sampled values of other code are not used either."""
    keys = {"evaluate": "[runs, ensemble]", "record": "{runs: all}", "uncertainty": "{eps: +-20%}"}
    path, out = write_estimation(tmp_path, **keys), tmp_path / "out"
    change_code(monkeypatch, 1)
    ran(path, out)
    with sqlite3.connect(out / "trials.sqlite") as connection:
        for table, column in (("traces", "data"), ("ensemble_groups", "mean")):
            connection.execute(f"UPDATE {table} SET {column} = zeroblob(length({column}))")
    connection.close()
    change(out, "uncertainty", lambda values: np.full(len(values), 99.0))
    change_code(monkeypatch, 2)
    ran(path, out)
    expected = tmp_path / "fresh"
    ran(path, expected)
    for name in ("trials.csv", "series.csv", "uncertainty.csv"):
        assert (out / name).read_bytes() == (expected / name).read_bytes()
    found, fresh = (load_trials(directory).traces["KF"].signals["y"] for directory in (out, expected))
    assert found.any() and found.tobytes() == fresh.tobytes()


def test_the_code_is_no_part_of_the_experiment(tmp_path, monkeypatch):
    """Directory and hash stay; the keys of the trials and of the sampled values change; the manifest has the number."""
    path = write(tmp_path)
    change_code(monkeypatch, 1)
    before = load_config(path)
    keys = before.points[0].method_keys, before.points[0].uncertainty_key
    change_code(monkeypatch, 2)
    after = load_config(path)
    assert (before.hash, before.full_hash) == (after.hash, after.full_hash)
    assert before.points[0].definitions == after.points[0].definitions
    assert keys[0]["S-MPC"] != after.points[0].method_keys["S-MPC"] and keys[1] != after.points[0].uncertainty_key
    ran(path, tmp_path / "out")
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["numerics"] == 2
