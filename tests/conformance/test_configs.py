"""Every configuration that we publish: it loads, builds, runs, and is what its file name says."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import ALL
from loaded_configs import loaded
from missing_libraries import skip_without_libraries

from rmpc_bench import load_config, publish, run
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.metrics.optimised_steps import QP, QpShare

ROOT = Path(__file__).parents[2] / "configs"
CONFIGS = sorted(path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.yaml"))
HEAVY = {
    "benchmarks/wang2021.yaml",
    "benchmarks/wkf2018.yaml",
    "benchmarks/xie1994.yaml",
    "examples/control.yaml",
    "examples/do-mpc.yaml",
    "examples/filterpy.yaml",
    "examples/libraries.yaml",
    "examples/pendulum.yaml",
    "ma2025/ablation.yaml",
    "souto2011/alpha.yaml",
    "souto2011/benchmarks.yaml",
    "souto2011/comparison.yaml",
    "souto2011/guarantee.yaml",
    "souto2011/table.yaml",
    "suite/suite-1.yaml",
    "zenere2017/interpretations-sim2.yaml",
    "zenere2017/sim2.yaml",
    "zenere2018/interpretations-sim2.yaml",
    "zenere2018/propositions.yaml",
    "zenere2018/rivals.yaml",
    "zenere2018/rivals-tuning.yaml",
    "zenere2018/signs.yaml",
}
"""Designs of theirs at full size take two to ten seconds: searches, 10,000 steps, many points, other libraries."""
LONG = {
    "belda2017/bounds.yaml",
    "belda2017/correlation.yaml",
    "belda2017/exp2.yaml",
    "belda2017/fair.yaml",
    "belda2017/sensitivity.yaml",
    "estimators/friction-tuned.yaml",
    "estimators/outliers.yaml",
    "examples/control.yaml",
    "examples/do-mpc.yaml",
    "examples/libraries.yaml",
    "examples/pendulum.yaml",
    "ma2025/ablation.yaml",
    "ma2025/certificate.yaml",
    "suite/suite-1.yaml",
}
"""Two runs of theirs take five seconds or more; `.ci/run` runs them by `make smoke`."""


def marked(slow):
    """All configurations, some of them among the slow tests."""
    return [pytest.param(name, marks=[pytest.mark.slow] * (name in slow)) for name in CONFIGS]


def check_names(config, name):
    """Results of configs/<paper>/<name>.yaml go to results/<paper>/<name>; a claim has a finding and a source.

    A claim that a paper makes from a figure has a figure here.
    """
    folder, _, stem = name.removesuffix(".yaml").rpartition("/")
    assert (config.name, bool(config.title)) == (stem, True)
    assert folder in ("benchmarks", config.paper or "")
    assert [claim.says for claim in config.claims if not (claim.finding and claim.source)] == []
    of_figures = [claim for claim in config.claims if claim.of_paper and "Fig" in claim.source]
    assert [claim.says for claim in of_figures if not claim.figures] == []


def test_there_are_configurations():
    """Collecting none would pass everything below."""
    assert CONFIGS


@pytest.mark.parametrize("name", sorted(LONG & HEAVY))
def test_names_of_what_is_run_elsewhere(name):
    """The small size has the same claims as those sizes that are loaded by the slow tests only."""
    skip_without_libraries(ROOT / name)
    check_names(load_config(ROOT / name, smoke=True), name)


@pytest.mark.parametrize("name", marked(LONG))
def test_two_runs_of_a_few_steps(name, tmp_path):
    """Every method completes two short runs with a value for every metric, at up to four points of a sweep.

    What is tuned runs at all points.  Where only exact moments are evaluated, there are these and no runs.  A method
    that solves no quadratic programs has no shares of them.
    """
    skip_without_libraries(ROOT / name)
    config = load_config(ROOT / name, runs=2, smoke=True)
    check_names(config, name)
    if config.tuning is None:
        config = replace(config, points=config.points[:: max(1, len(config.points) // 4)][:4])
    results = run(config, directory=tmp_path, jobs=1)
    if ALL:  # tables, figures and page too: a second per configuration
        assert publish(results).paths and (tmp_path / "report.html").is_file()
    trials = results.trials
    assert trials.methods == tuple(config.methods)
    n_runs = 2 if "runs" in config.evaluate else 0
    assert len(trials.frame) == n_runs * len(config.methods) * len(config.points)
    assert set(trials.frame["status"]) == ({"ok"} if n_runs else set())
    if "moments" in config.evaluate:
        exact = trials.series[(trials.series["quantity"] == "cov(e)") & (trials.series["n"] == 0)]
        assert set(exact["method"]) == set(config.methods) - trials.oracles
    made = config.points[0].experiment
    shares = [metric.name for metric in made.metrics if isinstance(metric, QpShare)]
    without = [method.name for method in made.methods if QP not in method.controller.reports]
    optimised = ~trials.frame["method"].isin(without)
    assert not trials.frame.drop(columns=shares).isna().any(axis=None)
    assert not trials.frame.loc[optimised, shares].isna().any(axis=None)


@pytest.mark.parametrize("name", marked(HEAVY))
def test_full_size_is_valid_and_survives_being_written(name, tmp_path):
    """All designs can be made, and what is written with every default filled in is the same experiment."""
    skip_without_libraries(ROOT / name)
    config = loaded(name.removesuffix(".yaml"))
    check_names(config, name)
    copy = tmp_path / "config.resolved.yaml"
    for module in (ROOT / name).parent.glob("*.py"):
        shutil.copy(module, tmp_path)
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(copy)
    assert (again.hash, again.full_hash) == (config.hash, config.full_hash)
    assert again.resolved == config.resolved
