"""Own components on the command line: list, describe, run with all kinds of components from files, workers."""

import pytest
from own_files import ESTIMATOR, write
from small_experiment import cli

from rmpc_bench.components import consent

PARTS = '''
"""Parts of a user."""
from dataclasses import dataclass

import numpy as np
from rmpc_bench import Figure, Metric, plant, single_run
from rmpc_bench.metrics.tracking import Mse
from rmpc_bench.types import Positive


@single_run
class Proportional:
    """Feedback of the first state.

    Parameters
    ----------
    K : gain [V/rad]
    """

    preview = 1

    def __init__(self, *, K: Positive = 2.0):
        self.K = K

    def control(self, x_hat, r):
        return self.K * (r - x_hat[:1])


class MyMse(Mse):
    pass


@dataclass(frozen=True)
class Dots(Figure):
    """A figure."""

    color: str = "k"

    def draw(self, results):
        from matplotlib.figure import Figure as Canvas
        from rmpc_bench.figures.files import FigureResult
        canvas = Canvas()
        canvas.subplots().plot([0, 1], [0, 1], self.color)
        return canvas


def design(Ts, *, J_l: Positive = 25.0):
    """My servomechanism.

    Parameters
    ----------
    J_l : inertia of the load
    """
    return plant("servo-linear", Ts, J_l=J_l)
'''


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Work in a directory with files of a user."""
    write(tmp_path, {"parts.py": PARTS})
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_describe_a_component_of_a_file(here):
    """Its docstring, its keys with their meanings and defaults; the file is named before its code runs."""
    result = cli("describe", "own.py:Own")
    assert result.exit_code == 0
    assert result.stdout.splitlines()[:3] == [
        "estimators/own.py:Own",
        "",
        "Copies the first state from the measurement.",
    ]
    assert "  gain  (default 0.1)" in result.stdout
    assert result.stderr.startswith("code  own.py (sha ")
    result = cli("describe", "parts.py:Proportional")
    assert "controllers/parts.py:Proportional" in result.stdout
    for text in ("  K  (default 2)  number", "      gain [V/rad]\n", "on_failure"):
        assert text in result.stdout
    result = cli("describe", "plants/parts.py:design")
    assert (
        "My servomechanism." in result.stdout
        and "  J_l  (default 25)  number > 0\n      inertia of the load" in result.stdout
    )
    assert "perturb : parameter -> factor" in result.stdout


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("parts.py:design", "parts.py:design: is it one of plants, models, "),
        ("own.py:Onw", "'Onw' is not a known name in own.py; did you mean 'Own'?"),
        ("onw.py:Own", "there is no file onw.py; did you mean 'own.py'?"),
        ("controllers/own.py:Own", "Own is an Estimator, no controller"),
        ("bad.py:Own", "bad.py:2: ZeroDivisionError: division by zero"),
    ],
)
def test_describe_what_is_no_component(here, name, message):
    """Exit 2 with the way out."""
    (here / "bad.py").write_text("\n1 / 0")
    result = cli("describe", name)
    assert result.exit_code == 2 and message in result.stderr


def test_list_the_components_of_a_file(here):
    """What the file defines itself, with the group of each."""
    result = cli("list", "parts.py")
    assert result.exit_code == 0
    assert result.stdout.splitlines() == [
        "figures  parts.py:Dots",
        "metrics  parts.py:MyMse",
        "controllers  parts.py:Proportional",
    ]
    assert cli("list", "none.py").exit_code == 2
    assert "did you mean 'plants'" in cli("list", "plant").stderr


def test_list_and_describe_without_files(here):
    """As before."""
    assert "kalman" in cli("list", "estimators").stdout
    assert "robust-kalman" in cli("describe", "estimators/robust-kalman").stdout


@pytest.mark.long
def test_run_with_files_of_every_kind(here):
    """Tables and figures are written; the screen names the files once."""
    path = write(
        here,
        plant="{file: parts.py:design, J_l: 24, perturb: {J_l: 1 + eps}}",
        controller="{file: parts.py:Proportional, K: 1.5}",
        metrics="[mse, {file: parts.py:MyMse, name: mine}]",
        figures="[boxplot, {file: parts.py:Dots, color: r}]",
    )
    shown = cli("check", path)
    assert shown.exit_code == 0 and " plant    parts.py:design" in shown.stdout, shown.output
    assert "plant parts.py:design" in cli("describe", path).stdout
    consent._named.clear()
    result = cli("run", path, "-o", "out", "-j", 2, "--progress", "none")
    assert result.exit_code == 0, result.output
    assert result.stderr.count("code  ") == 1 and "parts.py (sha" in result.stderr and "own.py (sha" in result.stderr
    head = (here / "out" / "trials.csv").read_text().splitlines()[0]
    assert "mse" in head and "mine" in head
    assert len([*(here / "out" / "figures").glob("*.svg"), *(here / "out" / "figures").glob("*.pdf")]) >= 2


def test_override_with_a_file(here):
    """`-s` takes a whole component; the results get a directory of their own."""
    write(here, {"more.py": ESTIMATOR})
    result = cli("run", "tiny.yaml", "-s", "methods.KF.estimator={file: more.py:Own}", "-n")
    assert result.exit_code == 0, result.output
    assert "results go to results/tiny~" in result.stdout
    result = cli("run", "tiny.yaml", "-s", "methods.KF.estimator={file: moer.py:Own}", "-n")
    assert result.exit_code == 2
    assert (
        "-s methods.KF.estimator={file: moer.py:Own}:1:29: methods.KF.estimator.file: there is no file" in result.stderr
    )
