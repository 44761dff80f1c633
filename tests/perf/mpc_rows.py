"""Predictive control with limits: the servomechanism over Fig. 7 of zenere2018, a block of 50 runs and all samples."""

from dataclasses import replace

import numpy as np

from perf.programs import design_model, solved_law
from perf.row import Row

BLOCK, STEPS, COMPARED = 50, 200, 10
"""Runs of a block, samples, and samples that the slow sides compute."""


def fig7():
    """Return the law with limits, the estimates of all runs over time, (samples, runs, n), and the reference."""
    from rmpc_bench.config.load import load_config
    from rmpc_bench.controllers.limits import Limits
    from rmpc_bench.controllers.mpc import Scale, design
    from rmpc_bench.simulation.closed_loop import simulate

    experiment, model = load_config("configs/zenere2018/fig7.yaml").experiment, design_model()
    scale, limits = Scale(u=440.0, y=2.0 * np.pi), Limits(u=(-220.0, 220.0), enforce="qp")
    made = design(model, Hp=10, Hu=3, Q=0.1, R=0.1, scale=scale, limits=limits)
    draws = experiment.scenario.draw(experiment.plant, range(BLOCK), STEPS)
    r = experiment.scenario.reference.sample(STEPS + 20)
    method = experiment.methods[0]._replace(controller=made)
    record, _ = simulate(experiment.plant, method, draws, r, STEPS)
    return made, np.ascontiguousarray(record.x_hat.transpose(1, 0, 2)), r


def inputs(*, skips):
    """Return the inputs of all samples, (samples, runs, nu)."""
    from rmpc_bench.types import Estimate

    made, x, r = fig7()
    made, status = replace(made, program=replace(made.program, skips=skips)), np.zeros(BLOCK, dtype=np.int8)

    def work():
        state, found = made.init(BLOCK), []
        for k in range(STEPS):
            state, command = made.control(k, state, x[k, :, :1], Estimate(x[k], None, None, status, {}), r[k : k + 11])
            found.append(command.u)
        return np.array(found)

    return work, STEPS * BLOCK


def one_by_one(solver):
    """Solve every program of the first samples with another program, run by run; as many numbers are compared."""
    _, x, r = fig7()
    solve = solver(r)

    def work():
        before, found = np.zeros(BLOCK), []
        for k in range(COMPARED):
            before = np.array([solve(x[k, i], before[i]) for i in range(BLOCK)])
            found.append(before)
        return np.array(found)

    return work, COMPARED * BLOCK


def cvxpy(r):
    """Return one parametrised problem of cvxpy in the moves divided by 440 V, solved by Clarabel."""
    import cvxpy as cp

    model, powers = design_model(), [np.eye(4)]
    for _ in range(10):
        powers.append(model.A @ powers[-1])
    free = np.array([(model.C @ power)[0] for power in powers[1:]])
    held = np.cumsum([(model.C @ power @ model.B)[0, 0] for power in powers[:-1]])
    moved = np.array([np.append(np.zeros(i), held[: 10 - i]) for i in range(3)]).T
    unit = 2.0 * np.pi
    root = np.sqrt(0.1) * np.vstack([440.0 / unit * moved, np.eye(3)])
    v, error, last = cp.Variable(3), cp.Parameter(13), cp.Parameter()
    inputs = last / 440.0 + cp.cumsum(v)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(root @ v + error)), [inputs >= -0.5, inputs <= 0.5])

    def solve(x_hat, before):
        last.value = before
        error.value = np.append(np.sqrt(0.1) / unit * (free @ x_hat + held * before - r[1:11, 0]), np.zeros(3))
        problem.solve(solver=cp.CLARABEL)
        return before + 440.0 * v.value[0]

    return solve


def do_mpc(r):
    """Return the same problem of do-mpc with states and inputs as variables, solved by IPOPT."""
    law = solved_law(design_model(), 220.0)
    return lambda x_hat, before: law(x_hat, np.array([before]))[0]


ROWS = [
    Row("MPC with limits, QP where they act", "run-step", lambda: inputs(skips=True), lambda: one_by_one(cvxpy),
        "cvxpy + Clarabel, one problem with parameters", 1e-4),
    Row("MPC with limits, every QP", "run-step", lambda: inputs(skips=False), lambda: one_by_one(cvxpy),
        "cvxpy + Clarabel, one problem with parameters", 1e-4),
    Row("MPC with limits, every QP", "run-step", lambda: inputs(skips=False), lambda: one_by_one(do_mpc),
        "do-mpc + IPOPT", 1e-4),
]  # fmt: skip
