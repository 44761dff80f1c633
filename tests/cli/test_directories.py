"""run: where results go, who may write there, and what is kept."""

import json
import os
import re

import pytest
from small_experiment import cli, ran, spied, write

from rmpc_bench.received import store
from rmpc_bench.store.store import Store


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Stand in an empty directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def go(path, *options):
    """Run with one process; nothing but results on stdout."""
    return cli("run", path, "-j", 1, "--progress", "none", *options)


def tree(directory):
    """Every file of a directory with its bytes."""
    return {path.relative_to(directory): path.read_bytes() for path in directory.rglob("*") if path.is_file()}


def test_another_experiment_in_the_directory(here):
    """Exit 5, the difference and the command for a new directory; nothing there changes."""
    ran(write(here), here / "out")
    before = tree(here / "out")
    result = go(write(here, seed=8), "-o", "out")
    assert result.exit_code == 5 and result.stdout == ""
    assert "out holds another experiment:\n  seed: there 7, here 8\n" in result.stderr
    command = re.search(r"rmpc-bench (run .*)", result.stderr)[1].split()
    assert tree(here / "out") == before
    assert cli(*command, "-j", 1).exit_code == 0
    assert tree(here / "out") == before


def test_the_command_for_a_new_directory_is_the_same_command(here):
    """With the overrides that made the difference."""
    path = write(here)
    ran(path, here / "out")
    result = go(path, "-o", "out", "-s", "seed=8")
    assert result.exit_code == 5
    command = re.search(r"rmpc-bench (run .*)", result.stderr)[1]
    assert "seed=8" in command


def test_a_second_writer(here, monkeypatch):
    """Exit 5 while another process writes; then it may."""
    monkeypatch.setattr(store, "READER_WAITS", 0.1)
    path = write(here)
    with Store(here / "out"):
        result = go(path, "-o", "out")
    assert result.exit_code == 5
    assert "another process writes to it" in result.stderr and "Traceback" not in result.stderr
    assert go(path, "-o", "out").exit_code == 0


def test_results_that_cannot_be_written(here):
    """Exit 74, one line, no traceback."""
    result = go(write(here), "-o", here / "tiny.yaml" / "out")
    assert result.exit_code == 74 and result.stdout == ""
    assert "results cannot be written" in result.stderr and len(result.stderr.splitlines()) == 1


def test_a_file_that_is_no_store(here):
    """Bad input: exit 2; it is left alone."""
    (here / "out").mkdir()
    (here / "out" / "trials.sqlite").write_text("my notes " * 200)
    before = tree(here / "out")
    result = go(write(here), "-o", "out")
    assert result.exit_code == 2 and "is not a trial store" in result.stderr
    assert tree(here / "out") == before


def test_fresh_renames(here, monkeypatch):
    """The old directory is kept whole under another name, and everything is computed again."""
    path = write(here)
    ran(path, here / "out")
    before, blocks = tree(here / "out"), spied(monkeypatch)
    result = go(path, "-o", "out", "--fresh")
    assert result.exit_code == 0 and len(blocks) == 2
    [old] = [each for each in here.iterdir() if each.name.startswith("out.")]
    assert str(old.name) in result.stderr and tree(old) == before
    assert (here / "out" / "trials.csv").read_bytes() == (old / "trials.csv").read_bytes()


def test_fresh_twice_within_a_second(here):
    """Every old directory is kept."""
    path = write(here)
    for count in range(3):
        assert go(path, "-o", "out", "--fresh").exit_code == 0
        assert len([each for each in here.iterdir() if each.name.startswith("out.")]) == count


def test_fresh_checks_the_configuration_first(here):
    """A mistake leaves the old results where they are; so does a first run, which has none."""
    assert go(write(here), "-o", "out", "--fresh").exit_code == 0
    assert go(write(here, seed=-1), "-o", "out", "--fresh").exit_code == 2
    assert {each.name for each in here.iterdir()} == {"out", "tiny.yaml"}


def test_fresh_of_the_directory_one_stands_in(here):
    """It cannot be renamed by its name; that is no internal error."""
    result = go(write(here), "-o", ".", "--fresh")
    assert result.exit_code != 70, result.stderr


def test_only_some_methods(here):
    """The others are absent, until they are asked for; an unknown one is an error."""
    path = write(here)
    only = ran(path, here / "out", "--only", "R-MPC")
    assert {line.split(b",")[0] for line in only.splitlines()[1:]} == {b"R-MPC"}
    assert ran(path, here / "out") == ran(path, here / "all")
    result = go(path, "--only", "RMPC")
    assert result.exit_code == 2 and "did you mean 'R-MPC'?" in result.stderr


def test_dry_run_writes_nothing(here, monkeypatch):
    """It says what is left to do, before and in the middle of the work."""
    path, blocks = write(here), spied(monkeypatch)
    result = go(path, "-n")
    assert result.exit_code == 0 and "tiny: 12 of 12 trials to compute (S-MPC, R-MPC)" in result.stdout
    assert "results/tiny" in result.stdout and [each.name for each in here.iterdir()] == ["tiny.yaml"]
    assert blocks == []
    ran(path, here / "out", "--runs", 4, "--only", "S-MPC")
    before = tree(here / "out")
    assert "8 of 12 trials to compute" in go(path, "-o", "out", "--dry-run").stdout
    assert tree(here / "out") == before


def test_dry_run_in_the_directory_of_another_experiment(here):
    """It does not promise what the run would refuse."""
    ran(write(here), here / "out")
    result = go(write(here, seed=8), "-o", "out", "--dry-run")
    assert result.exit_code == 5 or "0 of 12" not in result.stdout


def test_smoke_goes_to_its_own_place(here):
    """The small size, into results/smoke."""
    path = write(here, paper="p", time="{step: 0.1, steps: 500}", runs=100, smoke="{runs: 2, steps: 3}")
    result = go(path, "--smoke")
    assert result.exit_code == 0 and "2 of 2 runs" in result.stdout
    assert (here / "results" / "smoke" / "p" / "tiny" / "trials.csv").exists()
    assert {each.name for each in (here / "results").iterdir()} == {"smoke"}


def test_an_override_that_changes_the_experiment_has_its_own_directory(here):
    """Named by the hash, and a line says so; others stay where they belong."""
    path = write(here)
    assert go(path).exit_code == 0
    assert go(path, "-s", "execution.block=2", "-s", "title=new").exit_code == 0
    assert [each.name for each in (here / "results").iterdir()] == ["tiny"]
    for override in ("seed=8", "methods.R-MPC.estimator.c=0.5"):
        result = go(path, "-s", override)
        assert result.exit_code == 0
        [name] = re.findall(r"results go to results/(tiny~[0-9a-f]{6})\n", result.stderr)
        assert (here / "results" / name / "trials.csv").exists()
    assert len([*(here / "results").iterdir()]) == 3
    assert json.loads((here / "results" / name / "manifest.json").read_text())["modified"] == [f"-s {override}"]


@pytest.mark.parametrize("copy", ["config.yaml", "config.resolved.yaml"])
def test_the_copies_in_the_directory_continue_it(here, copy):
    """The configuration that lies beside the results runs them."""
    first = ran(write(here), here / "out")
    assert ran(here / "out" / copy, here / "out") == first


def test_an_empty_path(here):
    """That of a shell variable without a value is an error, and not the current directory."""
    path = write(here)
    for command in (["run", path, "-o", ""], ["check", ""], ["status", ""], ["report", here, "--to", ""]):
        result = cli(*command)
        assert result.exit_code == 2 and result.stdout == ""
        assert "must not be empty" in result.stderr
    assert [each.name for each in here.iterdir()] == [path.name]


@pytest.mark.parametrize("key", ["name", "paper"])
def test_names_that_are_too_long_for_a_directory(here, key):
    result = cli("check", write(here, **{key: "a" * 101}))
    assert result.exit_code == 2 and "1 to 100 letters" in result.stderr
    assert go(write(here, **{key: "a" * 100}), "--runs", 2).exit_code == 0


def test_the_group_may_write_what_the_process_allows(here):
    """Of the store as well, which SQLite makes with other rights."""
    before = os.umask(0o002)
    try:
        assert go(write(here), "-o", "out").exit_code == 0
    finally:
        os.umask(before)
    assert {path.stat().st_mode & 0o777 for path in (here / "out").iterdir() if path.is_file()} == {0o664}


def test_an_empty_store_is_named(here):
    """What was in it is computed again, and this is said."""
    (here / "out").mkdir()
    (here / "out" / "trials.sqlite").touch()
    result = cli("run", write(here), "-j", 1, "-o", "out", "--progress", "plain")
    assert result.exit_code == 0 and "trials.sqlite is empty: every trial is computed" in result.stderr
