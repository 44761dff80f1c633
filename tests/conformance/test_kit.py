"""The kit names what is wrong with a component, whatever the component does."""

import os
import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import misbehaving
import numpy as np
import pytest
from conftest import ROUND
from scipy.stats import chi2, norm
from small_experiment import cli, write

from rmpc_bench import load_config
from rmpc_bench.conformance import CHECKS, check, check_estimator, parametrize_with_checks
from rmpc_bench.conformance.estimators import band
from rmpc_bench.conformance.information import SeparateProcess
from rmpc_bench.conformance.process import check_subject
from rmpc_bench.conformance.results import Report, run_checks, with_expected
from rmpc_bench.conformance.stages import ExperimentExample, ExperimentSystem, Setting, stages
from rmpc_bench.conformance.subject import subject_of
from rmpc_bench.conformance.systems import LinearSystem
from rmpc_bench.types import Plant

FILE = Path(misbehaving.__file__)
SMALL = replace(LinearSystem.shipped(), n_runs=20, n_steps=100)
"""Fewer and shorter runs than the kit takes; faults of this size show all the same."""
SERVO = "{kind: servo-linear, Ts: 0.1, noise: {process: 1.0, measurement: 1.0}}"


@pytest.fixture(autouse=True)
def forgotten():
    """Components that keep something begin anew in every test."""
    misbehaving.SEEN.clear()
    misbehaving.SHARED.clear()


def small_check(component, group, **options):
    """Check a component in a process of its own, on fewer runs."""
    return check_subject(subject_of(component, group), system=SMALL, **options)


def results_here(component, group, monkeypatch):
    """Run the checks in this process and leave out those that need another one: id -> result."""
    monkeypatch.setattr(SeparateProcess, "__enter__", lambda self: self)
    setting = Setting(subject_of(component, group), group, SMALL)
    results, stopped = {}, False
    for stage in stages(setting):
        checks = [each for each in stage.checks if each.id not in ("function-of-data", "fresh-process")]
        if not stopped:
            found = run_checks(checks, stage.component, stage.example)
            results |= {result.id: result for result in found}
            stopped = any(result.status == "not checked" and result.reason.endswith("fails") for result in found)
    return results


ESTIMATORS = [
    ("Raising", "no-exception", "ValueError: negative level"),
    ("Unsolved", "solved", "maximum number of iterations reached"),
    ("NotANumber", "finite", "NaN or inf (k = 31)"),
    ("Infinite", "finite", "NaN or inf (k = 31)"),
    ("WrongShape", "shapes", "returned 3 numbers; the model has 2 states"),
    ("WrongType", "shapes", "real numbers are expected"),
    ("SinglePrecision", "shapes", "x_hat is float32, not float64"),
    ("Reusing", "own-arrays", "a later call changes an array"),
    ("Overwriting", "arguments", "argument"),
    ("GlobalNumpy", "random-state", "use `rng`"),
    ("GlobalPython", "random-state", "use `rng`"),
    ("Unseeded", "repeated", "random generator without a seed"),
    ("Leaking", "repeated", "does something remain from an earlier run"),
    ("Leaking", "batch-independence", "of run"),
    ("Foreseeing", "causal", "uses the future: with another y from k = 81 on x_hat changes 1 sample ahead"),
    ("Peeking", "possible", "it uses the true state or later measurements"),
    ("Late", "in-time", "x_hat(k) fits x(k-1) best"),
    ("Late", "exact", "it returns x(k-1), 1 sample late"),
    ("Early", "exact", "it returns the prediction x(k+1|k) with no input"),
    ("LateInput", "exact", "it uses u(k-2) instead of u(k-1)"),
    ("NoInput", "exact", "it does not use the input"),
    ("Loss", "consistent", "P is too small"),
]


@pytest.mark.parametrize(("name", "id", "words"), ESTIMATORS)
def test_a_fault_of_an_estimator_is_named(name, id, words, monkeypatch):
    """Oracle: the fault that was built in."""
    result = results_here(getattr(misbehaving, name), "estimators", monkeypatch)[id]
    assert result.status == "failed" and words in result.reason, result


@pytest.mark.parametrize("name", ["Textbook", "InPlace"])
def test_a_textbook_filter_passes(name, monkeypatch):
    """Arrays that are used again are harmless in a component written for one run, which gets and gives copies."""
    results = results_here(getattr(misbehaving, name), "estimators", monkeypatch)
    assert [str(each) for each in results.values() if each.status == "failed"] == []
    assert "times the error" in results["in-time"].reason and "nees" in results["consistent"].reason


def test_an_input_that_the_loop_does_not_limit_is_named(monkeypatch):
    """Oracle: a plant whose bounds the simulation leaves out."""
    monkeypatch.setattr(Plant, "applied_inputs", lambda self, u, runs=None: u)
    result = results_here(misbehaving.Textbook, "estimators", monkeypatch)["applied-input"]
    assert result.status == "failed" and "where the plant limits the input" in result.reason


def test_the_in_place_filter_has_the_numbers_of_the_textbook():
    """Oracle: the same filter without reused arrays."""
    system = LinearSystem.shipped()
    made = [
        Setting(subject_of(each), "estimators", system).made(system.n_steps)
        for each in (misbehaving.Textbook, misbehaving.InPlace)
    ]
    first, second = (system.simulated(each).x_hat for each in made)
    np.testing.assert_array_equal(first, second)
    # Of the size of the state, where an estimate is near 0.
    np.testing.assert_allclose(first, system.simulated(system.kalman).x_hat, **ROUND, atol=1e-14)


@pytest.mark.parametrize(("name", "id", "words"), [("ForeseeingLaw", "preview", "uses the future: with another r")])
def test_a_fault_of_a_controller_is_named(name, id, words, monkeypatch):
    """Oracle: the fault that was built in."""
    result = results_here(getattr(misbehaving, name), "controllers", monkeypatch)[id]
    assert result.status == "failed" and words in result.reason, result


@pytest.mark.parametrize("name", ["Follower", "BatchLaw"])
def test_a_law_that_keeps_the_rules_passes(name, monkeypatch):
    """Oracle: the rules by inspection of two lines."""
    results = results_here(getattr(misbehaving, name), "controllers", monkeypatch)
    assert [str(each) for each in results.values() if each.counts] == []


def test_a_plant_with_memory_is_named(monkeypatch):
    """The second of two equal methods begins where the first one ended; objects that `draw` returns are made again."""
    results = results_here(misbehaving.StickyWalk, "plants", monkeypatch)
    assert "keeps something of the first method" in results["methods-apart"].reason
    assert results["repeated"].counts
    for fine in (misbehaving.Walk, misbehaving.SharedObjects):
        assert results_here(fine, "plants", monkeypatch)["methods-apart"].status == "passed"


@pytest.mark.parametrize("degrees", [100, 1000])
def test_the_band_is_that_of_chi_square(degrees):
    """Oracle: the quantiles of scipy; the approximation of Wilson and Hilferty is off by 2e-3 at most."""
    expected = chi2.ppf(norm.cdf([-4.0, 4.0]), degrees) / degrees
    np.testing.assert_allclose(band(degrees), expected, atol=2e-3)


# -- in processes of their own -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def textbook():
    """Return all checks of the textbook filter."""
    return check(f"{FILE}:Textbook")


def test_all_checks_pass_in_a_process_of_its_own(textbook):
    """The report has every check of the list, in its order; oracle: the list."""
    assert textbook.passed and textbook.group == "estimators"
    assert [result.id for result in textbook.results] == [each.id for each in CHECKS["estimators"]]
    assert {result.status for result in textbook.results} == {"passed", "not checked"}
    for id in ("function-of-data", "fresh-process"):
        assert textbook.result(id).status == "passed"


@pytest.mark.long
def test_reading_the_true_state_is_named():
    """In a process without a plant there is nothing to read."""
    report = small_check(misbehaving.Peeking, "estimators")
    assert {result.id for result in report.failed} == {"function-of-data", "possible"}
    assert "in a process without a plant x_hat of run 0 differs from k = 0" in report.result("function-of-data").reason
    report = small_check(misbehaving.PeekingLaw, "controllers")
    assert [result.id for result in report.failed] == ["function-of-data"]


def test_the_hash_seed_is_named():
    """The same component has the same bits with the same hash seed, so that it does not use the plant."""
    report = small_check(misbehaving.Hashing, "estimators")
    assert [result.id for result in report.failed] == ["fresh-process"]
    assert "PYTHONHASHSEED" in report.result("fresh-process").reason


@pytest.mark.long
def test_an_endless_loop_ends_with_its_place():
    """The time limit holds, the kit names the line, and no process is left."""
    report = small_check(misbehaving.Endless, "estimators", seconds=4.0)
    [failed] = report.failed
    assert failed.id == "no-exception" and "an endless loop in answer at misbehaving.py:" in failed.reason
    assert failed.reason.endswith("For a slow component give a longer limit, --seconds 40")
    assert "not checked" in str(report) and "because no-exception fails" in str(report)


def test_an_exit_does_not_end_the_kit():
    """Oracle: the exit code of the component."""
    [failed] = small_check(misbehaving.Exiting, "estimators").failed
    assert failed.id == "no-exception" and "the process ended with code 3" in failed.reason


def test_declared_failures_have_their_reason(textbook):
    """A declared failure does not count; one that passes does, and so does one that is no check."""
    report = small_check(misbehaving.Loss, "estimators")
    assert report.passed and report.result("consistent").status == "expected"
    assert "the loss is not quadratic; nees" in report.result("consistent").reason
    results = textbook.results
    boasting = with_expected(results, misbehaving.Boasting.expected_failures)
    assert [(each.id, each.counts) for each in boasting if each.status == "failed"] == [("exact", True)]
    confused = Report("", "", with_expected(results, misbehaving.Confused.expected_failures))
    assert "there is no check 'exactly'" in confused.failed[0].reason


def test_a_local_class_is_sent_by_value():
    """What stands in no file, such as a class of a notebook, is checked as well."""

    class Local(misbehaving.Batch):
        def estimate(self, x_hat, y):
            raise RuntimeError("local")

    [failed] = check_estimator(Local).failed
    assert failed.id == "no-exception" and "local" in failed.reason


def test_a_function_of_the_kit_has_its_name():
    """So that a pool of processes can call it."""
    assert pickle.loads(pickle.dumps(check_estimator)) is check_estimator
    assert check_estimator.__doc__ == "Check an estimator; see `check` for the options."


# -- the command line --------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_command_line(tmp_path, monkeypatch):
    """Exit code 0 with a table, 1 with the failed check, and messages for what cannot be checked."""
    fine = cli("check", "--component", f"{FILE}:Follower", "--keys", "{K: 50%}")
    assert fine.exit_code == 0 and "passed       causal" in fine.stdout, fine.output
    late = cli("check", "--component", f"{FILE}:Late", "--model", SERVO)
    assert late.exit_code == 1 and "FAILED       exact" in late.stdout, late.output
    misspelt = cli("check", "--component", f"{FILE}:Follower", "--keys", "{k: 1}")
    assert misspelt.exit_code == 1 and "did you mean 'K'" in misspelt.stdout
    assert "there is no file" in cli("check", "--component", "missing.py:A").output
    assert "give one or more configurations" in cli("check").output
    assert "must be a YAML mapping" in cli("check", "--component", f"{FILE}:Follower", "--keys", "[1]").output
    monkeypatch.setenv("RMPC_BENCH_NO_CODE", "1")
    assert "refuses all Python files" in cli("check", "--component", f"{FILE}:Follower").output


@pytest.mark.long
def test_own_components_of_an_experiment(tmp_path):
    """`check --deep` checks them on the system of their design model; methods with equal ones share the check."""
    shutil.copy(FILE, tmp_path / "own.py")
    methods = (
        "{A: {estimator: {file: own.py:Late}}, B: {estimator: {file: own.py:Late}}, C: {estimator: {kind: kalman}}}"
    )
    result = cli("check", "--deep", write(tmp_path, methods=methods))
    assert result.exit_code == 1, result.output
    own = " ".join(result.stdout.partition("own components")[2].split())
    assert own.count("own.py:Late") == 1 and "error exact: " in own and "it returns x(k-1), 1 sample late" in own
    assert "own components" not in cli("check", "--deep", write(tmp_path)).stdout


def test_an_estimator_in_the_experiment_itself(tmp_path):
    """Where the design model is not linear, the plant of the experiment stands in for the linear system."""
    shutil.copy(FILE, tmp_path / "own.py")
    methods = "{A: {estimator: {file: own.py:Foreseeing}}, B: {estimator: {file: own.py:Textbook}}}"
    experiment = load_config(write(tmp_path, methods=methods)).experiment
    found = {}
    for method in experiment.methods:
        example = ExperimentExample(ExperimentSystem(experiment, method.name), method.estimator)
        found[method.name] = run_checks(ExperimentExample.checks, method.estimator, example)
    failed = {name: [each.id for each in results if each.status == "failed"] for name, results in found.items()}
    assert failed == {"A": ["causal"], "B": []}


def test_a_file_that_cannot_be_imported(tmp_path):
    """The message has the line of the user's file."""
    path = tmp_path / "broken.py"
    path.write_text("import numpy\n1 / 0\n", encoding="utf-8")
    report = check(f"{path}:A")
    assert report.failed[0].id == "signature" and "broken.py:2: ZeroDivisionError" in report.failed[0].reason
    assert os.listdir(tmp_path) == ["broken.py"]


@parametrize_with_checks([f"{FILE}:Textbook"])
def test_parametrised(check):
    """One test per check; all checks are run once."""
    check()
