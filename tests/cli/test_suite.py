"""`rmpc-bench suite`: sets by name, one table of ranks, a method from a file, several sets, mistakes."""

from pathlib import Path

import pandas as pd
import pytest
from small_experiment import cli, text

SWEEP = (
    "{grid: {noise: {modelled: {measurement: {gaussian: {std: 0.01}}}, more: {measurement: {gaussian: {std: 0.1}}}}}}"
)
FILTER = '''
"""A Kalman filter with another measurement noise."""

from rmpc_bench.estimators.gain_schedule import Inflation, riccati_schedule


def design(model, n_steps, *, x0, P0, factor: float = 1.2):
    """Multiply the prediction covariance."""
    return riccati_schedule(model, n_steps, x0, P0, lambda k, root: Inflation(factor**0.5 * root, 0.0))
'''


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Stand in a directory with two small sets."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "configs" / "suite"
    folder.mkdir(parents=True)
    for name in ("mini", "micro"):
        keys = {"name": name, "paper": "suite", "runs": 4, "statistics": "{ranks: true}", "sweep": SWEEP}
        (folder / f"{name}.yaml").write_text(text(**keys))
    (tmp_path / "my_filter.py").write_text(FILTER)
    return tmp_path


def suite(*options):
    """Call the verb in this process."""
    return cli("suite", *options, "-j", 1, "--progress", "none", "-q")


def test_a_method_from_a_file_is_in_the_table(place):
    """One command adds a line to the table of ranks, which stands in place of that of the points."""
    done = suite("mini", "--add-method", "mine: {estimator: {file: my_filter.py:design}}")
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    head = next(n for n, line in enumerate(lines) if line.startswith(" method"))
    assert lines[head].split()[-1] == "rank"
    assert {line.split()[0] for line in lines[head + 1 : head + 4]} == {"mine", "S-MPC", "R-MPC"}
    out = place / "results" / "suite" / "mini"
    table = pd.read_csv(out / "ranks.csv")
    assert {*table["method"][table["axis"].isna()]} == {"mine", "S-MPC", "R-MPC"}
    assert (out / "tables" / "ranks.md").exists()


def test_one_filter_for_systems_of_several_sizes(place):
    """The first call of a file's component is made for every size of the plant."""
    benchmarks = Path(__file__).parents[2] / "configs" / "benchmarks"
    rows = [f"{{name: {name}, plant.from: {benchmarks / name}.yaml}}" for name in ("sayed2001", "f404")]
    (place / "configs" / "suite" / "sizes.yaml").write_text(
        f"version: 1\nname: sizes\nruns: 2\ntime: {{steps: 5}}\nplant: {{from: {benchmarks / 'sayed2001.yaml'}}}\n"
        f"methods: {{KF: {{estimator: {{kind: kalman}}}}}}\nsweep: {{zip: [{', '.join(rows)}]}}\n"
        "metrics: [estimation_mse]\nfigures: []\n"
    )
    done = suite("sizes", "--add-method", "mine: {estimator: {file: my_filter.py:design}}", "--dry-run")
    assert done.exit_code == 0, done.output
    assert "8 of 8 trials to compute (KF, mine)" in done.stdout


def test_several_sets_have_a_directory_each(place):
    """Below that of the option; without runs of their own with --dry-run."""
    done = suite("mini", "suite/micro", "-o", place / "out", "--dry-run")
    assert done.exit_code == 0, done.output
    assert f"results go to {place / 'out' / 'mini'}" in done.stdout and f"{place / 'out' / 'micro'}" in done.stdout
    assert not (place / "out").exists()


def test_an_unknown_set_is_refused(place):
    """With the nearest name."""
    done = suite("minni")
    assert done.exit_code == 2 and "did you mean 'mini'" in done.output


def test_the_worst_exit_code_is_that_of_the_suite(place):
    """A mistake in one set does not hide behind another one."""
    (place / "configs" / "suite" / "micro.yaml").write_text("version: 1\nname: micro\n")
    done = suite("micro", "mini", "--dry-run")
    assert done.exit_code == 2 and "trials to compute" in done.stdout
