"""run --add-method: one more method in a finished directory, which keeps it."""

import json

import pytest
from small_experiment import cli, ran, spied, write

from rmpc_bench import load_config, load_results, run

C = "R-MPC-c0.03: {estimator: {kind: robust-kalman, c: 0.03}}"
CLAIM = "[{says: R-MPC wins, source: s, check: 'mean(mse[R-MPC]) < mean(mse[S-MPC])', finding: confirmed}]"


@pytest.fixture
def finished(tmp_path):
    """A configuration, its finished directory and the bytes of its trials."""
    path = write(tmp_path, claims=CLAIM)
    return path, tmp_path / "out", ran(path, tmp_path / "out")


def rows_of(directory, *methods):
    head, *rows = (directory / "trials.csv").read_bytes().splitlines(keepends=True)
    return b"".join([head, *(row for row in rows if row.split(b",")[0].decode() in methods)])


def test_only_the_new_method_is_computed(finished, monkeypatch):
    """The rows of the others keep their bytes, and so do the claims."""
    path, directory, before = finished
    claims = (directory / "claims.json").read_bytes()
    blocks = spied(monkeypatch)
    ran(path, directory, "--add-method", C)
    assert blocks == [("R-MPC-c0.03", [0, 1, 2, 3, 4, 5])]
    assert rows_of(directory, "S-MPC", "R-MPC") == before
    assert len((directory / "trials.csv").read_bytes().splitlines()) == 1 + 18
    assert (directory / "claims.json").read_bytes() == claims
    assert load_results(directory).is_final


def test_the_directory_keeps_the_method(finished, monkeypatch):
    """In a later run without the option, in a report, and in both copies of the configuration; the screen says so."""
    path, directory, _ = finished
    ran(path, directory, "--add-method", C)
    after = (directory / "trials.csv").read_bytes()
    blocks = spied(monkeypatch)
    again = cli("run", path, "-o", directory, "--progress", "none")
    assert again.exit_code == 0 and not blocks
    assert "added before and kept: R-MPC-c0.03" in again.stderr
    assert (directory / "trials.csv").read_bytes() == after
    assert "R-MPC-c0.03" in cli("report", directory).stdout
    resolved = load_config(directory / "config.resolved.yaml")
    assert resolved.methods["R-MPC-c0.03"]["estimator"]["c"] == 0.03
    lines = (directory / "config.yaml").read_text().splitlines()
    assert lines[-1] == f"# this directory has more methods: --add-method '{C}'"
    assert "\n".join(lines[:-1]) + "\n" == path.read_text()


def test_a_second_method_joins_the_first(finished):
    """Behind it, and the same method again changes nothing."""
    path, directory, _ = finished
    ran(path, directory, "--add-method", C)
    ran(path, directory, "--add-method", "K: {estimator: {kind: kalman}}", "--add-method", C)
    assert load_results(directory).trials.methods == ("S-MPC", "R-MPC", "R-MPC-c0.03", "K")
    assert [*load_results(directory).experiment.added] == ["R-MPC-c0.03", "K"]


def test_another_method_of_the_same_name_takes_its_place(finished, monkeypatch):
    """With a line; the trials of both are stored."""
    path, directory, _ = finished
    ran(path, directory, "--add-method", C)
    other = cli("run", path, "-o", directory, "--progress", "none", "--add-method", C.replace("c: 0.03", "c: 0.05"))
    assert other.exit_code == 0 and "in place of another method of this name" in other.stderr
    blocks = spied(monkeypatch)
    ran(path, directory, "--add-method", C)
    assert not blocks


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        ("A: {estimator: {kind: robust-kalmann, c: 1}}", "1:23: methods.A.estimator.kind", "mean 'robust-kalman'?"),
        ("A: {estimator: {kind: robust-kalman, c: -1}}", "1:41: methods.A.estimator.c", "must be > 0 (got -1)"),
        ("A: {estimater: {kind: kalman}}", "1:5: methods.A.estimater", "did you mean 'estimator'?"),
        ("R-MPC: {estimator: {kind: kalman}}", "1:1: methods.R-MPC", "is a method of the configuration already"),
        ("A: {estimator: {kind: kalman}", "1:", "expected"),
        ("A", "1:1: ", "must be a mapping such as"),
        ("A: kalman", "1:4: A", "must be a mapping with an estimator"),
        ("A: {estimator: !delete }", "1:16: A.estimator", "tags are not allowed"),
    ],
)  # fmt: skip
def test_a_wrong_method(tmp_path, text, place, message):
    """With its place in the text, exit code 2, and nothing is written."""
    path = write(tmp_path)
    found = cli("run", path, "-o", tmp_path / "out", "--add-method", text)
    assert found.exit_code == 2
    assert f"--add-method {text}:{place}" in found.stderr and message in found.stderr
    assert not (tmp_path / "out").exists()


def test_the_same_name_twice(tmp_path):
    """In one command."""
    found = cli("run", write(tmp_path), "--add-method", "A: {}", "--add-method", "A: {estimator: {kind: kalman}}")
    assert found.exit_code == 2 and "is added twice" in found.stderr


def test_claims_are_named_where_there_are_some(finished, tmp_path):
    """The intervals of verdicts change without claims, too."""
    for path in (finished[0], write(tmp_path, file="other.yaml", claims=None)):
        said = cli("run", path, "-o", tmp_path / "dry", "--dry-run", "--add-method", C).stderr
        assert "intervals of verdicts are simultaneous for 2 methods now" in said
        assert ("claims rest on" in said) == (path == finished[0])


def test_with_overrides_the_directory_is_that_of_the_overrides(tmp_path, monkeypatch):
    """The added method does not change its name."""
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path)
    for options in ((), ("--add-method", C)):
        assert cli("run", path, "-s", "seed=9", "--progress", "none", "-j", 1, *options).exit_code == 0
    assert len([*(tmp_path / "results").iterdir()]) == 1


def test_a_program_that_runs_the_configuration_leaves_the_record_alone(finished, capsys):
    """Its tables show the methods of its configuration, with a line; the next command line has the method again."""
    path, directory, before = finished
    ran(path, directory, "--add-method", C)
    results = run(load_config(path), directory=directory, jobs=1)
    assert results.trials.methods == ("S-MPC", "R-MPC")
    assert "is not in this configuration: no table shows it" in capsys.readouterr().err
    assert json.loads(json.dumps(dict(results.experiment.added))) == {"R-MPC-c0.03": C}
    assert b"R-MPC-c0.03" in ran(path, directory)
