"""`init` writes an experiment with own components; nothing that exists is changed."""

import os
import re
import shutil
import subprocess
import sys
from difflib import unified_diff
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rmpc_bench.cli import main
from rmpc_bench.models.linear import LinearModel


def init(directory, *arguments):
    before = Path.cwd()
    os.chdir(directory)
    try:
        return CliRunner().invoke(main, ["init", *arguments])
    finally:
        os.chdir(before)


def components(directory, *arguments):
    """Write the starter files and return the names in its module."""
    assert init(directory, "mine", *arguments).exit_code == 0
    found = {}
    exec(compile((directory / "mine.py").read_text(encoding="utf-8"), "mine.py", "exec"), found)  # noqa: S102
    return found


def test_it_writes_four_files_and_says_how_to_go_on(tmp_path):
    done = init(tmp_path, "mine")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".gitignore", "mine.py", "mine.yaml", "test_mine.py"]
    assert done.stdout.splitlines() == [
        "next    rmpc-bench check --component mine.py:MHE",
        "        rmpc-bench run mine.yaml",
    ]
    for path in tmp_path.iterdir():
        text = path.read_text(encoding="utf-8")
        assert not any(word in text for word in ("NAME", "ESTIMATOR", "CONTROLLER", "IMPORTS"))


@pytest.mark.parametrize("estimator", ["mhe", "plain"])
def test_its_files_are_formatted(tmp_path, estimator):
    init(tmp_path, "mine", "--estimator", estimator)
    for arguments in (["check", "--select", "E,F,I,UP,B"], ["format", "--check"]):
        command = [sys.executable, "-m", "ruff", *arguments, "--line-length", "120", str(tmp_path)]
        subprocess.run(command, check=True, capture_output=True)


def test_existing_files_are_not_changed(tmp_path):
    (tmp_path / "mine.py").write_text("x = 1\n", encoding="utf-8")
    done = init(tmp_path, "mine")
    assert done.exit_code == 2
    assert "mine.py: exists already" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["mine.py"]
    assert (tmp_path / "mine.py").read_text(encoding="utf-8") == "x = 1\n"


def test_an_existing_gitignore_stays(tmp_path):
    (tmp_path / ".gitignore").write_text("*.o\n", encoding="utf-8")
    assert init(tmp_path, "mine").exit_code == 0
    assert (tmp_path / ".gitignore").read_text(encoding="utf-8") == "*.o\n"


@pytest.mark.parametrize("name", ["my-tanks", "1st", "a/b", "a.b"])
def test_a_name_that_is_no_module_is_refused(tmp_path, name):
    done = init(tmp_path, name)
    assert done.exit_code == 2
    assert not [*tmp_path.iterdir()]


def test_the_moving_horizon_estimator_is_the_kalman_filter_for_a_large_delta(tmp_path):
    """Oracle: the textbook recursion; ROUND times the condition of the window."""
    A, B, C = np.array([[0.9, 0.0], [0.08, 0.93]]), np.array([[1e-3], [4e-5]]), np.array([[0.0, 1.0]])
    Q, R, f0, d0 = 1e-6 * np.eye(2), np.array([[4e-6]]), np.array([1e-3, 2e-3]), np.array([0.01])
    model = LinearModel(A, B, C, Q, R, f0=f0, d0=d0)
    estimator = components(tmp_path)["MHE"](model, Ne=4, delta=1e9)
    rng, x_pred, P, u = np.random.default_rng(2), np.array([0.1, 0.0]), 1e-4 * np.eye(2), None
    estimator.start(x_pred, P)
    for _ in range(30):
        y = 0.1 + 2e-3 * rng.standard_normal(1)
        K = P @ C.T / (C @ P @ C.T + R)
        x_hat = x_pred + K @ (y - C @ x_pred - d0)
        np.testing.assert_allclose(estimator.update(y, u), x_hat, rtol=1e-9)
        u = rng.standard_normal(1)
        x_pred, P = A @ x_hat + B @ u + f0, A @ (P - K @ C @ P) @ A.T + Q


def test_an_outlier_moves_the_moving_horizon_estimate_less(tmp_path):
    model = LinearModel(np.eye(1), np.zeros((1, 1)), np.eye(1), 1e-4 * np.eye(1), np.eye(1))
    robust, quadratic = (components(tmp_path / name)["MHE"](model, delta=delta) for name, delta in _variants(tmp_path))
    for estimator in (robust, quadratic):
        estimator.start(np.zeros(1), np.eye(1))
        for y in (0.1, -0.1, 0.0, 100.0):
            x_hat = estimator.update(np.array([y]), None if y == 0.1 else np.zeros(1))
        estimator.last = x_hat
    assert abs(robust.last) < 0.1 * abs(quadratic.last)


def _variants(directory):
    for name in ("robust", "quadratic"):
        (directory / name).mkdir()
    return ("robust", 1.5), ("quadratic", 1e9)


def test_the_share_and_the_size_of_outliers_are_those_asked_for(tmp_path):
    law = components(tmp_path)["outliers"](1, std=2.0, probability=0.1, factor=5.0)
    values = law.draw(np.random.default_rng(5), 200_000)
    expected = 2.0 * np.sqrt(0.9 + 0.1 * 25.0)
    assert abs(values.std() / expected - 1.0) < 0.02  # five standard errors of the spread of this mixture
    assert abs(values.mean()) < 5.0 * expected / np.sqrt(200_000)


@pytest.mark.parametrize("estimator", ["mhe", "plain"])
def test_recorded_data_come_with_a_configuration_that_fits_them(tmp_path, estimator):
    from rmpc_bench import load_config

    done = init(tmp_path, "mine", "--plant", "data", "--estimator", estimator)
    assert done.exit_code == 0
    assert len([*(tmp_path / "mine_data").glob("run-*.csv")]) == 8
    text = "".join(path.read_text(encoding="utf-8") for path in tmp_path.glob("*mine.*"))
    assert not any(word in text for word in ("NAME", "ESTIMATOR", "CONTROLLER", "IMPORTS"))
    assert len(load_config(tmp_path / "mine.yaml").points[0].experiment.methods) == 3


ROOT = Path(__file__).parents[2]
ADDED = {"estimators": "new-filter", "controllers": "new-law", "metrics": "new_metric"}
"""A new kind of every group with a template."""


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """Return a directory with the files that list the kinds, in which `init` adds components."""
    for template in (ROOT / "rmpc_bench/cli/templates").glob("component_*.txt"):
        for file in re.findall("^== (.+)", template.read_text(encoding="utf-8"), re.MULTILINE):
            place = tmp_path / file.partition(": ")[0]
            place.parent.mkdir(parents=True, exist_ok=True)
            if ": " in file:
                shutil.copy(ROOT / place.relative_to(tmp_path), place)
    monkeypatch.setattr(import_module("rmpc_bench.cli.init"), "ROOT", tmp_path)
    return tmp_path


def contents(directory):
    files = [path for path in directory.rglob("*.*") if path.suffix in (".py", ".yaml")]
    return {path.relative_to(directory).as_posix(): path.read_text("utf-8") for path in files}


@pytest.mark.parametrize(("group", "kind"), ADDED.items())
def test_a_new_component_is_written_and_listed(clone, group, kind):
    """Only lines are added, and the code is formatted; tests/docs/test_contributing.py runs its tests."""
    before = contents(clone)
    done = init(clone, "--component", f"{group}/{kind}")
    assert done.exit_code == 0, done.stderr
    after, module = contents(clone), kind.replace("-", "_")
    assert {*after} - {*before} == {f"rmpc_bench/{group}/{module}.py", f"tests/{group}/test_{module}.py"}
    for file in before:
        changes = [*unified_diff(before[file].splitlines(), after[file].splitlines(), n=0)]
        assert len(changes) != 1 and not [line for line in changes[2:] if line.startswith("-")]
    assert all(kind in after[f"{file}.py"] for file in ("rmpc_bench/registry", f"tests/conformance/test_{group}"))
    assert done.stdout.splitlines()[1:] == [
        "        make docs lint type",
        f"        pytest -k '{' or '.join(dict.fromkeys([kind, module, 'every_kind']))}'",
    ]
    # To sort imports ruff looks whether their modules are there.
    ignored = shutil.ignore_patterns("__pycache__", "cli")
    shutil.copytree(ROOT / "rmpc_bench", clone / "rmpc_bench", dirs_exist_ok=True, ignore=ignored)
    shutil.copy(ROOT / "pyproject.toml", clone)
    for arguments in (["check"], ["format", "--check"]):
        command = [sys.executable, "-m", "ruff", *arguments, *({*after} - {*before})]
        subprocess.run(command, cwd=clone, check=True, capture_output=True)


def test_all_that_is_in_the_way_of_a_component_is_said_at_once(clone):
    (clone / "tests/estimators/test_new_filter.py").write_text("", encoding="utf-8")
    (clone / "rmpc_bench/registry.py").write_text("", encoding="utf-8")
    before = contents(clone)
    done = init(clone, "--component", "estimators/new-filter")
    assert done.exit_code == 2 and contents(clone) == before
    assert done.stderr.splitlines() == [
        "tests/estimators/test_new_filter.py exists already",
        'rmpc_bench/registry.py: expected one line `"estimators": {`, found 0',
        "nothing was written",
    ]


@pytest.mark.parametrize(
    ("component", "message"),
    [
        ("estimators/kalman", "estimators/kalman exists already"),
        ("estimator/kalman", "estimators/kalman exists already"),
        ("plants/mine", "GROUP is one of estimators, controllers, metrics, others are written by hand"),
        ("my-filter", "--component is GROUP/NAME"),
        ("metrics/my-metric", "lower case letters, digits and _, such as my_filter"),
        ("estimators/lambda", "'lambda' is not a name of a kind"),
        ("controllers/true", "'true' is not a name of a kind"),
        ("controllers/regulator", "'regulator': its module imports Regulator; choose another name"),
        ("estimators/__init__", "'__init__' is not a name of a kind"),
        ("estimators/gain-schedule", "rmpc_bench/estimators/gain_schedule.py exists already"),
        ("estimators/Filter", "at most 30 lower case letters, digits and -, such as my-filter"),
        ("estimators/new(\0", "is not a name of a kind"),
        ("estimators/f\u00edlter", "is not a name of a kind"),
        ("estimators/new-filter\n", "is not a name of a kind"),
        (f"estimators/{'long' * 100}", "at most 30 lower case letters"),
        ("estimators/../kalman", "'../kalman' is not a name of a kind"),
        ("estimators/", "'' is not a name of a kind"),
    ],
)
def test_a_wrong_name_of_a_component_is_explained(clone, component, message):
    (clone / "rmpc_bench/estimators/gain_schedule.py").touch()
    before = contents(clone)
    done = init(clone, "--component", component)
    assert done.exit_code == 2 and message in done.stderr and contents(clone) == before


def test_a_component_is_added_to_a_clean_clone_only(clone, tmp_path_factory, monkeypatch):
    """What `git diff` shows is then the component."""
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    assert "the current directory is not in" in init(elsewhere, "--component", "estimators/new-filter").stderr
    subprocess.run(["git", "init", "-q"], cwd=clone, check=True)
    subprocess.run(
        ["git", "-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "a", "--allow-empty"], cwd=clone
    )
    done = init(clone, "--component", "estimators/new-filter")
    assert done.exit_code == 2 and "uncommitted changes; commit or stash them" in done.stderr
    monkeypatch.setattr(import_module("rmpc_bench.cli.init"), "ROOT", elsewhere)
    done = init(elsewhere, "--component", "estimators/new-filter")
    assert done.exit_code == 2 and "is not a clone of rmpc-bench; `rmpc-bench init NAME` writes" in done.stderr
    assert [*elsewhere.iterdir()] == []


@pytest.mark.parametrize("error", [KeyboardInterrupt(), PermissionError(13, "Permission denied", "FILE")])
def test_a_component_is_written_as_a_whole_or_not_at_all(clone, monkeypatch, error):
    """The fourth of its files is not written."""
    module, written = import_module("rmpc_bench.cli.init"), []

    def replace_text(place, text):
        written.append(place)
        if len(written) == 4:
            raise error
        place.write_text(text, encoding="utf-8")

    before = contents(clone)
    monkeypatch.setattr(module, "replace_text", replace_text)
    done = init(clone, "--component", "estimators/new-filter")
    assert len({*written}) == 4 and contents(clone) == before
    assert done.exit_code == (130 if isinstance(error, KeyboardInterrupt) else 74)
    assert isinstance(error, KeyboardInterrupt) or done.stderr.endswith("'FILE'; nothing was written\n")


@pytest.mark.parametrize("link", ["rmpc_bench/registry.py", "tests/estimators", "tests/estimators/test_new_filter.py"])
def test_a_component_is_not_written_through_a_link(clone, tmp_path_factory, link):
    there = tmp_path_factory.mktemp("there") / "there"
    if (clone / link).exists():
        (clone / link).rename(there)
    (clone / link).symlink_to(there)
    done = init(clone, "--component", "estimators/new-filter")
    assert done.exit_code == 2 and " is a symbolic link, or in one; a clone has none" in done.stderr
    assert not [*clone.rglob("new_filter.py")] and (not there.is_file() or "new-filter" not in there.read_text("utf-8"))


def test_a_component_goes_with_no_other_option(clone):
    done = init(clone, "mine", "--component", "estimators/new-filter")
    assert done.exit_code == 2 and "--component goes with nothing else" in done.stderr
