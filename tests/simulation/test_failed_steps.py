"""Failed steps of a constrained controller: from the loop to the store, the tables and the replay of a run."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from rmpc_bench import load_trials
from rmpc_bench.cli import main
from rmpc_bench.config.load import load_config
from rmpc_bench.controllers.limits import Limits, SoftLimit
from rmpc_bench.controllers.mpc import Scale, design
from rmpc_bench.execution.replay import replay
from rmpc_bench.models.servo import ServoNoise
from rmpc_bench.models.servo import design as servo
from rmpc_bench.report.run_notes import failed_sentences
from rmpc_bench.simulation import closed_loop
from rmpc_bench.simulation.closed_loop import simulate, simulate_block
from rmpc_bench.types import Status

FIG7 = Path("configs/zenere2018/fig7.yaml")
TEXT = """
version: 1
name: failing
seed: 1
runs: 3
time: {step: 0.1, steps: 10}
plant: {kind: servo-linear}
model: {kind: servo-linear, noise: {process: 1.0, measurement: 1.0}}
noise: none
initial: {x: 0, x_hat: 0, P: process}
reference: {kind: constant, value: pi/2}
estimator: {kind: kalman}
controller: {kind: mpc, Hp: 10, Hu: 3, Q: 0.1, R: 0.1, scale: {u: 440, y: 2*pi},
             limits: {u: [-20, 20], du: [5, 10], enforce: qp}}
methods:
  clip: {}
  hold: {controller: {limits: {fallback: hold}}}
  stop: {controller: {limits: {fallback: stop}}}
  plain: {controller: {limits: {enforce: clip}}}
metrics: [mse]
"""


@pytest.fixture(scope="module")
def failing(tmp_path_factory):
    """Return the results of methods whose increments are at least 5 V, so that no moves stay within 20 V."""
    directory = tmp_path_factory.mktemp("failing")
    (directory / "failing.yaml").write_text(TEXT, encoding="utf-8")
    path, out = directory / "failing.yaml", directory / "out"
    # Commands of long paths leave less room for notes.
    with contextlib.chdir(directory):
        done = CliRunner().invoke(main, ["run", path.name, "-o", out.name, "-j", "1", "--progress", "none"])
    assert "the optimisation failed in 27 of 30 steps" in done.output
    return load_trials(out), out


def test_a_failed_step_is_not_a_failed_run(failing):
    """Oracle: u(0) = 10 V is feasible within Hu = 3 moves of 5 V only from u(-1) <= 5 V on: all later steps fail."""
    trials, _ = failing
    words = trials.frame.groupby("method")["status"].agg(set)
    assert words["clip"] == words["hold"] == words["plain"] == {"ok"} and words["stop"] == {"infeasible"}
    notes = trials.notes["clip"]
    assert notes.optimises and notes.failed_steps == {i: {"infeasible": 9} for i in range(3)}
    assert not trials.notes["plain"].optimises and not trials.notes["stop"].failed_steps
    assert notes.worst_step_of(0) == "infeasible" and trials.notes["plain"].worst_step_of(0) == "ok"
    said = failed_sentences(trials)[0]
    assert said.startswith("clip: the optimisation failed in 27 of 30 steps (27 infeasible), in 3 runs")


def test_tables_and_the_replay_show_failed_steps(failing):
    """Oracle: the counts above, in trials.csv, tables/summary.md and the replayed run."""
    _, out = failing
    rows = pd.read_csv(out / "trials.csv").set_index(["method", "run"])
    assert rows.loc[("hold", 1), ["failed_steps", "worst_step"]].tolist() == [9, "infeasible"]
    assert rows.loc[("plain", 1), ["failed_steps", "worst_step"]].tolist() == [0, "ok"]
    text = (out / "tables" / "summary.md").read_text(encoding="utf-8")
    assert "## Failed steps" in text and "| failed steps |" in text and "90 %" in text
    assert "the optimisation failed in 27 of 30 steps" in (out / "report.html").read_text(encoding="utf-8")
    assert replay(out, 1, "clip").failed_steps == {"infeasible": 9}
    shown = CliRunner().invoke(main, ["show", str(out), "--run", "1", "--method", "clip"]).output
    assert "steps whose optimisation failed, where the fallback was applied: 9 infeasible" in shown


def fig7_with(limits, soft=None):
    """Return Fig. 7 with its first method under limits."""
    experiment, model = load_config(FIG7).experiment, servo(0.1, noise=ServoNoise(1.0, 1.0))
    scale = Scale(u=440.0, y=2.0 * np.pi)
    law = design(model, Hp=10, Hu=3, Q=0.1, R=0.1, scale=scale, limits=limits, soft=soft)
    return experiment, experiment.methods[0]._replace(controller=law)


def test_skipping_changes_nothing_over_fig7():
    """Oracle: every program solved, 1e-9 V over all 200 plants and all samples."""
    soft = {"shaft_torque": SoftLimit((-25 * np.pi, 25 * np.pi), 0.001)}
    experiment, method = fig7_with(Limits(u=(-220.0, 220.0), enforce="qp"), soft)
    law = method.controller
    every = method._replace(controller=replace(law, program=replace(law.program, skips=False)))
    n, preview = experiment.n_steps, law.preview
    draws = experiment.scenario.draw(experiment.plant, range(experiment.n_runs), n)
    r = experiment.scenario.reference.sample(n + 1 + preview)
    found, status = simulate(experiment.plant, method, draws, r, n, info={"qp"})
    other, _ = simulate(experiment.plant, every, draws, r, n, info={"qp"})
    assert not status.any() and 0.5 < (found.info["qp"] == 0).mean() < 0.99 and (other.info["qp"] > 0).all()
    np.testing.assert_allclose(found.u, other.u, rtol=0, atol=1e-9)


def test_constraints_are_never_simulated_by_the_compiled_loop(monkeypatch):
    """Oracle: a compiled loop that raises; the plain clipped law does use it."""

    def used(*arguments, **keywords):
        raise RuntimeError("compiled")

    monkeypatch.setattr(closed_loop, "compiled_loop", used)
    for limits, compiled in ((Limits(u=(-220.0, 220.0)), True), (Limits(u=(-220.0, 220.0), enforce="qp"), False),
                             (Limits(u=(-220.0, 220.0), du=(-50.0, 50.0)), False)):  # fmt: skip
        experiment, method = fig7_with(limits)
        experiment = replace(experiment, n_runs=10**6)
        if compiled:
            with pytest.raises(RuntimeError, match="compiled"):
                simulate_block(experiment, method, range(2))
        else:
            assert simulate_block(experiment, method, range(2)).status.tolist() == [Status.OK] * 2
