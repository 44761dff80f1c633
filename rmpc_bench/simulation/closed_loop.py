"""The simulation loop: measure, correct, control, move the plant, predict."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.simulation.scenario import Draws, Experiment
from rmpc_bench.types import Array, Method, Plant, Record, Status, Statuses

OK, DIVERGED = np.int8(Status.OK), np.int8(Status.DIVERGED)  # looked up once: members of an enum are slow to reach
LARGEST = 1e100
"""Beyond this a run counts as diverged: its square must still be a number that can be summed."""


class Block(NamedTuple):
    """What is kept of a block of runs."""

    status: Statuses
    metrics: Float[Array, "metrics runs"]
    """NaN where the run failed."""
    traces: Mapping[str, Float[Array, "recorded samples n"]]
    """Signal -> trajectories of the first runs of the block, as many as are to be recorded."""


def simulate_block(experiment: Experiment, method: Method, runs: range) -> Block:
    """Simulate a block of runs with one method and reduce it to its metrics.

    Parameters
    ----------
    experiment : what to simulate
    method : the estimator-controller pair
    runs : indices of the runs
    """
    plant, n_steps = experiment.plant, experiment.n_steps
    draws = experiment.scenario.draw(plant, runs, n_steps)
    r = experiment.scenario.reference.sample(n_steps + 1 + method.controller.preview)
    record, status = simulate(plant, method, draws, r, n_steps)
    ok = status == OK
    with np.errstate(over="ignore", invalid="ignore"):  # of failed runs
        values = [np.where(ok, metric.evaluate(record), np.nan) for metric in experiment.metrics]
    n_recorded = max(0, min(len(runs), experiment.recording.n_runs - runs.start))
    traces = {name: getattr(record, name)[:n_recorded] for name in experiment.recording.signals if n_recorded}
    return Block(status, np.array(values).reshape(len(values), len(ok)), traces)


def simulate(
    plant: Plant, method: Method, draws: Draws, r: Float[Array, "known ny"], n_steps: int
) -> tuple[Record, Statuses]:
    """Simulate all runs of ``draws`` over samples k = 0..n_steps and return their trajectories.

    A run whose status leaves `Status.OK` stands still from then on; the others do not notice.

    Parameters
    ----------
    plant, method : the truth and the pair that controls it
    draws : what befalls the runs
    r : reference from k = 0 on, n_steps + the controller's preview samples at least
    n_steps : number of control periods N
    """
    estimator, controller = method.estimator, method.controller
    n_runs, x = len(draws.x0), draws.x0
    e, c = estimator.init(n_runs), controller.init(n_runs)
    status = np.full(n_runs, OK)
    xs, ys, x_hats, us = [], [], [], []
    still = np.zeros_like(draws.v[:, 0])
    with np.errstate(over="ignore", invalid="ignore"):  # a run that overflows is marked, not warned of
        for k in range(n_steps + 1):
            y = plant.output(k, draws.delta, x, draws.v[:, k])
            e, estimate = estimator.correct(k, e, y)
            status = _first(status, estimate.status, _in_range(estimate.x_hat))
            xs.append(x)
            ys.append(plant.output(k, draws.delta, x, still))
            x_hats.append(estimate.x_hat)
            if k == n_steps:
                break
            c, command = controller.control(k, c, y, estimate, r[k : k + controller.preview])
            status = _first(status, command.status, _in_range(command.u))
            motion = plant.step(k, draws.delta, x, command.u, draws.w[:, k])
            status = _first(status, motion.status, _in_range(motion.x))
            x = np.where((status == OK)[:, None], motion.x, x)
            us.append(command.u)
            e = estimator.predict(k, e, command.u)
    # Stacked with the run first and contiguous in memory: sums over time then do not depend on the number of runs.
    x_all, y_all, x_hat_all, u_all = (np.ascontiguousarray(np.stack(part, axis=1)) for part in (xs, ys, x_hats, us))
    return Record(plant.Ts, x_all, y_all, x_hat_all, u_all, r[: n_steps + 1]), status


def _in_range(values: Float[Array, "runs n"]) -> Bool[Array, " runs"]:
    return np.asarray((np.abs(values) < LARGEST).all(axis=1))  # False for NaN, too


def _first(status: Statuses, reported: Statuses, finite: Bool[Array, " runs"]) -> Statuses:
    """Keep the first failure of every run."""
    news = np.where(reported != OK, reported, np.where(finite, OK, DIVERGED))
    return np.where(status != OK, status, news)
