"""Generalised predictive control with limits: the robot of belda2017 at random poses, one model for every run."""

from dataclasses import replace

import numpy as np

from perf.row import Row

BLOCK, TORQUE, EDGE = 50, 0.2, 0.08


def robot(*, wide=False):
    """Return the controller, states, measurements and the reference; wide limits never act."""
    from rmpc_bench.controllers.gpc import design
    from rmpc_bench.controllers.limits import Limits, SoftLimit
    from rmpc_bench.models.moving_slide import design as model

    factor = 1e3 if wide else 1.0
    soft = {"y.0": SoftLimit(limits=(-EDGE * factor, EDGE * factor), linear=1e-3)}
    limits = Limits(u=(-TORQUE * factor, TORQUE * factor), enforce="qp")
    controller = design(model(0.01), Np=10, Q_yw=1.0, Q_u=1e-2, limits=limits, soft=soft)
    x = np.random.default_rng(5).uniform(-1.0, 1.0, (BLOCK, 6)) * [0.08, 0.08, 0.3, 0.3, 0.3, 1.0]
    return controller, x, np.tile([0.05, 0.05, 0.1], (11, 1))


def inputs(*, skipped):
    """Return the inputs of a block where no limit acts, or with every program solved."""
    from controllers.gpc_twin import estimate_of

    controller, x, r = robot(wide=skipped)
    controller = replace(controller, limits=replace(controller.limits, skips=skipped))
    repeated, start = (40 if skipped else 3), controller.init(BLOCK)

    def work():
        return [controller.control(0, start, x[:, :3], estimate_of(x), r)[1].u for _ in range(repeated)][0]

    return work, repeated * BLOCK


def without_limits():
    """Return the inputs of the law without limits."""
    from controllers.gpc_twin import estimate_of

    controller, x, r = robot()
    controller, start = replace(controller, limits=None), controller.init(BLOCK)

    def work():
        return [controller.control(0, start, x[:, :3], estimate_of(x), r)[1].u for _ in range(40)][0]

    return work, 40 * BLOCK


def by_cvxpy():
    """Return the inputs of the block by one problem of cvxpy per run; costs times 1e4, or Clarabel stops too early."""
    from controllers.gpc_program_twin import Problem, by_clarabel

    controller, x, r = robot()
    A, B = controller.model.at_state(x)
    C, Z, u, du = np.eye(3, 6), np.eye(1, 6), (-TORQUE, TORQUE), (-1e3, 1e3)
    given = [
        Problem(A[i], B[i], np.zeros(6), C, 100.0 * np.eye(3), np.eye(4), r[1:], x[i], np.zeros(4), u, du,
                Z, np.zeros(1), (-EDGE, EDGE), np.array([2.0 * EDGE]), 10.0, 10.0, 10)
        for i in range(BLOCK)
    ]  # fmt: skip
    return lambda: [by_clarabel(each)[0][0] for each in given], BLOCK


ROWS = [
    Row("GPC with limits, none acts", "run", lambda: inputs(skipped=True), without_limits, "law without limits"),
    Row("GPC with limits, every QP", "run", lambda: inputs(skipped=False), by_cvxpy, "cvxpy + Clarabel", 1e-3),
]
