"""rmpc-bench compare: two directories run by run, and the difference of two improvements."""

import shutil
from dataclasses import replace

import pytest
from small_experiment import cli, ran, write

from rmpc_bench import compare_improvements, compare_results, load_results
from rmpc_bench.results.compare import differing

UNCERTAIN = "uncertainty={eps: +-40%}"


@pytest.fixture(scope="module")
def directories(tmp_path_factory):
    """Results of the small experiment, with a wider uncertainty, with more runs and with another seed."""
    there = tmp_path_factory.mktemp("compare")
    path = write(there, claims="[{says: R-MPC wins, source: s, check: 'mean(mse[R-MPC]) < 0', finding: confirmed}]")
    options = {"a": (), "wide": ("-s", UNCERTAIN), "more": ("--runs", 8), "seed": ("-s", "seed=8")}
    for name, given in options.items():
        ran(path, there / name, *given)
    return there


def test_a_directory_equals_its_copy(directories, tmp_path):
    """The text says what that rests on, and is the same every time."""
    shutil.copytree(directories / "a", tmp_path / "copy")
    first = cli("compare", directories / "a", tmp_path / "copy")
    assert first.exit_code == 0, first.output
    assert "\nEqual (exact): 12 trials in both, 24 values of metrics, all statuses.\n" in first.stdout
    listed = cli("compare", directories / "a", tmp_path / "copy", "--values").stdout
    assert "equal (exact): 12 trials in both, 24 values of metrics, all statuses" in listed
    assert first.stdout == cli("compare", directories / "a", tmp_path / "copy").stdout


def test_differences_are_named_and_exit_with_1(directories):
    """Settings from the stored record, metrics with the run of the largest difference."""
    found = cli("compare", directories / "a", directories / "wide")
    assert found.exit_code == 1
    assert "\nThe verdicts are the same; " in found.stdout and "\nchange of the MSE against S-MPC\n" in found.stdout
    assert " settings that differ:\n   uncertainty.eps: A +-0.2, B +-0.4\n" in found.stdout
    found = cli("compare", directories / "a", directories / "wide", "--values")
    assert found.exit_code == 1
    assert "uncertainty.eps: A +-0.2, B +-0.4" in found.stdout
    assert "options: A -, B -s 'uncertainty={eps: +-40%}'" in found.stdout
    assert "R-MPC mse: 6 of 6 runs; largest relative difference" in " ".join(found.stdout.split())
    assert cli("compare", directories / "a", directories / "wide", "--tol", "10").exit_code == 0


def test_a_range_is_written_in_its_unit():
    """A law from -2 to 2 is no 200 %: it may be a force; another range has both ends."""
    laws = {"force": (-2, 2), "angle": (-0.25, 0.25), "mass": (0.5, 1)}
    a, b = ({name: {"low": f * low, "high": f * high} for name, (low, high) in laws.items()} for f in (1, 2))
    found = [(each.path, each.a, each.b) for each in differing(a, b)]
    assert found == [("force", "+-2", "+-4"), ("angle", "+-0.25", "+-0.5"), ("mass", "0.5 to 1", "1.0 to 2")]


def test_swept_values_are_settings(tmp_path):
    """Those of a path that only one sweep has, and those of a path of both."""
    for name, sweep in (("one", "{grid: {controller.Hp: [5, 10]}}"), ("other", "{grid: {controller.Hp: [10, 15]}}")):
        ran(write(tmp_path, sweep=sweep, runs=2), tmp_path / name)
    ran(write(tmp_path, sweep="{grid: {seed: [1, 2]}}", runs=2), tmp_path / "seeds")
    found = cli("compare", tmp_path / "one", tmp_path / "other", "--values").stdout
    assert "sweep.controller.Hp: A 5, 10, B 10, 15" in found
    found = cli("compare", tmp_path / "one", tmp_path / "seeds", "--values").stdout
    assert "sweep.controller.Hp: A 5, 10, B -" in found and "sweep.seed: A -, B 1, 2" in found


def test_more_runs_are_a_difference(directories):
    """The common ones are equal, whatever was added."""
    found = cli("compare", directories / "a", directories / "more", "--tol", "1")
    assert found.exit_code == 1
    assert " only in B: runs 6-7 of S-MPC, R-MPC\n" in found.stdout
    found = cli("compare", directories / "a", directories / "more", "--tol", "1", "--values")
    assert "different (up to a relative difference of 1): one has more than the other" in " ".join(found.stdout.split())


def test_a_method_in_one_only(directories, tmp_path):
    """Its trials are not compared; those of the others are equal."""
    shutil.copytree(directories / "a", tmp_path / "copy")
    path = directories / "tiny.yaml"
    ran(path, tmp_path / "copy", "--add-method", "More: {estimator: {kind: robust-kalman, c: 0.3}}")
    found = cli("compare", directories / "a", tmp_path / "copy")
    assert found.exit_code == 1 and "B: method More" in found.stdout
    results = compare_results(load_results(directories / "a"), load_results(tmp_path / "copy"))
    assert not results.equal and not results.trials.differing and results.trials.n_trials == 12
    assert results.to_frame()["n_differ"].sum() == 0


def test_usage_errors(directories, tmp_path):
    """A directory without a store, unknown names and options that exclude each other: exit code 2."""
    a, wide = directories / "a", directories / "wide"
    for given, text in (
        ((a, tmp_path), "there is no trials.sqlite"),
        ((a, tmp_path / "none"), "does not exist"),
        ((a, wide, "--of", "R-NPC"), "did you mean 'R-MPC'?"),
        ((a, wide, "--of", "S-MPC"), "is the baseline itself"),
        ((a, wide, "--of", "R-MPC", "--metric", "msee"), "did you mean 'mse'?"),
        ((a, wide, "--metric", "mse"), "--metric needs --of METHOD"),
        ((a, wide, "--of", "R-MPC", "--tol", "1"), "give one of them"),
        ((a, wide, "--tol", "-1"), "is not in the range"),
    ):
        found = cli("compare", *given)
        assert found.exit_code == 2 and text in found.output, found.output


def test_different_baselines_are_refused(directories, tmp_path):
    """Their improvements mean different things."""
    ran(directories / "tiny.yaml", tmp_path / "other", "-s", "statistics={baseline: R-MPC}")
    found = cli("compare", directories / "a", tmp_path / "other", "--of", "R-MPC")
    assert found.exit_code == 2 and "improvements on different baselines: S-MPC and R-MPC" in found.output


def test_the_difference_of_two_improvements(directories):
    """One sentence with both changes, their difference, the ratio of ratios, n and a word."""
    found = cli("compare", directories / "a", directories / "wide", "--of", "R-MPC")
    assert found.exit_code == 0, found.output
    line = " ".join(found.stdout.split())
    assert " with uncertainty.eps = +-0.2 and " in line and " with uncertainty.eps = +-0.4: " in line
    assert "the difference of the improvements is " in line and "6 paired runs, 95 % intervals" in line
    # The claim names the mean.
    assert "ratios of the means" in line and "geometric mean of the paired ratios: " in found.stdout


def test_other_seeds_are_not_paired(directories):
    """And the text says so; a metric that is not the primary one has no word."""
    found = cli("compare", directories / "a", directories / "seed", "--of", "R-MPC", "--metric", "input_power")
    assert found.exit_code == 0, found.output
    assert "unpaired: 6 and 6 runs with different seeds" in " ".join(found.stdout.split()) and "Welch" in found.stdout
    assert "): " not in " ".join(found.stdout.split()).partition("R-MPC ")[2].partition(". ")[0]
    table = compare_improvements(
        load_results(directories / "a"), load_results(directories / "seed"), "R-MPC", metric="input_power"
    ).to_frame()
    assert table["average"].tolist() == ["mean", "geometric"] and not table["paired"].any()
    assert table["verdict"].tolist() == ["", ""]


def test_the_parameters_of_both_directories_are_named(directories):
    """Once where they are alike; a method that is tuned in one of them only is not called tuned in the other."""
    a, b = load_results(directories / "a"), load_results(directories / "wide")
    (text,) = compare_improvements(a, b, "R-MPC").sentences
    assert "intervals; both default, not tuned)" in text
    words = {"S-MPC": "default", "R-MPC": "tuned (budget 9, 50 runs)"}
    (text,) = compare_improvements(a, replace(b, stored=replace(b.stored, parameters=words)), "R-MPC").sentences
    tuned = "R-MPC: tuned (budget 9, 50 runs), S-MPC: default, not tuned"
    assert f"intervals; in A both default, not tuned; in B {tuned})" in text
