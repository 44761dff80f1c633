"""Experiments of the papers at a small size: trials and series have the same bytes for any blocks and interruptions."""

import signal
from pathlib import Path

import pytest

from rmpc_bench import load_config, run
from rmpc_bench.engines import tasks

ROOT = Path(__file__).parents[2] / "configs"
N_RUNS = 53
"""A group of 50 runs and a part of the next one."""
CONFIGS = {
    "souto2011/fig4": ("smoke.steps=12",),
    "ma2025/fig1-3": ("smoke.steps=12",),
    "ma2025/table2": ("smoke.steps=5", "evaluate=[runs, ensemble]"),
    "belda2017/exp1": (
        *("smoke.steps=12", "evaluate=[runs, ensemble]", "claims=[]"),
        *("metrics=[{kind: input_rms, name: u_rms}]", "statistics.primary=u_rms"),
    ),
}


def loaded(name, block):
    """Return a configuration at its small size, with blocks of a size."""
    overrides = (*CONFIGS[name], f"smoke.runs={N_RUNS}", f"execution.block={block}")
    return load_config(ROOT / f"{name}.yaml", overrides=overrides, runs=N_RUNS, smoke=True)


def texts(results):
    """Return trials and series as text with every digit."""
    return results.trials.frame.to_csv(), results.series.to_csv()


@pytest.fixture(scope="module", params=CONFIGS)
def case(request, tmp_path_factory):
    """Return the name of a configuration and its results in one block."""
    expected = run(loaded(request.param, 1000), directory=tmp_path_factory.mktemp("whole"), jobs=1)
    assert set(expected.trials.frame["run"]) == {*range(N_RUNS)}
    assert "cov(x)" in set(expected.series["quantity"]) and set(expected.trials.frame["status"]) == {"ok"}
    return request.param, texts(expected)


@pytest.mark.parametrize(("block", "jobs"), [pytest.param(1, 1, marks=pytest.mark.slow), (7, 1), (64, 2)])
def test_any_block(case, tmp_path, block, jobs):
    """Blocks of one run, of a part of a group and of more than one, in any order."""
    name, expected = case
    assert texts(run(loaded(name, block), directory=tmp_path, jobs=jobs, engine="joblib")) == expected


@pytest.mark.long
def test_interrupted(case, tmp_path, monkeypatch):
    """Stopped in the middle of a group, and continued with other blocks."""
    name, expected = case
    simulate = tasks.simulate_block

    def interrupted(experiment, method, runs, *draws):
        if runs.start >= 20:
            signal.raise_signal(signal.SIGINT)
        return simulate(experiment, method, runs, *draws)

    monkeypatch.setattr(tasks, "simulate_block", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(loaded(name, 8), directory=tmp_path, jobs=1)
    monkeypatch.setattr(tasks, "simulate_block", simulate)
    assert texts(run(loaded(name, 30), directory=tmp_path, jobs=1)) == expected
