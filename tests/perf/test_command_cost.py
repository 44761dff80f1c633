"""CPU time of the command line, on imports of the libraries that a figure needs; `make perf` prints the table.

Nothing here asserts a time: the rows are compared with `test_imports`, in the same session.
"""

import os
import subprocess
import sys

import pytest

from rmpc_bench.config.load import load_config
from rmpc_bench.execution.results import run

FIG7, QUICKSTART = "configs/zenere2018/fig7.yaml", "configs/quickstart.yaml"
MAIN = "from rmpc_bench.cli import main; main()"


def of_children():
    """CPU time of all processes that have ended [s]."""
    found = os.times()
    return found.children_user + found.children_system


pytestmark = [pytest.mark.perf, pytest.mark.benchmark(timer=of_children)]


def measured(benchmark, code, *arguments, rounds=3):
    """Run Python in a process of its own."""
    command = [sys.executable, "-c", code, *arguments]
    benchmark.pedantic(subprocess.run, (command,), {"check": True, "capture_output": True}, rounds=rounds)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Return a directory with all runs of Fig. 7."""
    directory = tmp_path_factory.mktemp("fig7")
    run(load_config(FIG7), directory=directory)
    return str(directory)


def test_imports(benchmark):
    """The plain baseline: what a picture and a table need at least, without this package."""
    measured(benchmark, "import numpy, scipy.linalg, numba, pandas, matplotlib.figure")


@pytest.mark.parametrize("arguments", [["--help"], ["list", "configs"], ["check", FIG7]], ids=" ".join)
def test_without_runs(benchmark, arguments):
    """Nothing is simulated or drawn."""
    measured(benchmark, MAIN, *arguments)


def test_run_with_a_full_store(benchmark, stored):
    """Nothing to compute: tables, claims, figures and page are written again."""
    measured(benchmark, MAIN, "run", FIG7, "-o", stored, "--progress", "none")


def test_report_of_fig7(benchmark, stored):
    """The same from the store alone."""
    measured(benchmark, MAIN, "report", stored)


def test_first_experiment(benchmark, tmp_path):
    """The first command of the guide, with its simulation."""
    measured(benchmark, MAIN, "run", QUICKSTART, "--fresh", "-o", str(tmp_path / "quickstart"))
