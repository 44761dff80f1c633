"""Predictive control with limits: the servomechanism over Fig. 7 of zenere2018, a block of 50 runs and all samples."""

from dataclasses import replace

import numpy as np

from perf.row import Row

BLOCK, STEPS, COMPARED = 50, 200, 10
"""Runs of a block, samples, and samples that the slow sides compute."""


def fig7():
    """Return the law with limits, the estimates of all runs over time, (samples, runs, n), and the reference."""
    from rmpc_bench.config.load import load_config
    from rmpc_bench.controllers.limits import Limits
    from rmpc_bench.controllers.mpc import Scale, design
    from rmpc_bench.models.servo import ServoNoise
    from rmpc_bench.models.servo import design as servo
    from rmpc_bench.simulation.closed_loop import simulate

    experiment, model = load_config("configs/zenere2018/fig7.yaml").experiment, servo(0.1, noise=ServoNoise(1.0, 1.0))
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
    made, x, r = fig7()
    solve = solver(made, r)

    def work():
        before, found = np.zeros(BLOCK), []
        for k in range(COMPARED):
            before = np.array([solve(x[k, i], before[i]) for i in range(BLOCK)])
            found.append(before)
        return np.array(found)

    return work, COMPARED * BLOCK


def cvxpy(made, r):
    """Return one parametrised problem of cvxpy in the scaled moves, solved by Clarabel."""
    import cvxpy as cp

    program, ahead = made.program, np.append(r[1:11].ravel(), 1.0)
    size, rows = program.size, program.rows
    root = np.linalg.cholesky(size[:, None] * program.H * size).T
    v, f, moved = cp.Variable(len(size)), cp.Parameter(len(size)), cp.Parameter(len(rows.low))
    z = (rows.A * size / rows.unit[:, None]) @ v + moved
    rules = [z >= rows.low / rows.unit, z <= rows.high / rows.unit]
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(root @ v) + f @ v), rules)

    def solve(x_hat, before):
        p = np.concatenate([x_hat, [before], ahead])
        f.value, moved.value = size * (program.F @ p), rows.E @ p / rows.unit
        problem.solve(solver=cp.CLARABEL)
        return before + size[0] * v.value[0]

    return solve


def do_mpc(made, r):
    """Return the same problem of do-mpc with states and inputs as variables, solved by IPOPT."""
    from perf.programs import design_model, solved_law

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
