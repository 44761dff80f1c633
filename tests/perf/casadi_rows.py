"""Functions of CasADi as plants: a step of the plant, and the function mapped over the runs in a plain loop."""

import numpy as np

from perf.row import Row

RUNS, STEPS, TS, SUBSTEPS = 50, 50, 5.0, 4


def given():
    """Return the initial states, inputs (steps, runs, nu) and parameters of every run."""
    from plants import tanks

    rng = np.random.default_rng(0)
    nominal = np.tile([*tanks.PARAMETERS.values()], (RUNS, 1))
    p = nominal * rng.uniform(0.9, 1.1, nominal.shape)
    return rng.uniform(0.1, 0.2, (RUNS, 2)), rng.uniform(5.0, 10.0, (STEPS, RUNS, 1)), p


def through_adapter():
    """Simulate the tanks as a block of runs."""
    from adapters.casadi_systems import two_tanks

    from rmpc_bench.plants.ode_stepping import Solver

    made = two_tanks(solver=Solver(substeps=SUBSTEPS))
    x0, u, p = given()
    delta = made.draw(dict(zip(made.nominal, p.T, strict=True)), [None] * RUNS, STEPS)

    def work():
        x = x0
        for k in range(STEPS):
            x = made.step(k, delta, x, u[k], np.zeros_like(x)).x
        return x

    return work, RUNS * STEPS


def plain():
    """Call the function for all runs at once, in the same Runge-Kutta steps."""
    from adapters.casadi_systems import function

    slopes, (x0, u, p), h = function().map(RUNS), given(), TS / SUBSTEPS

    def slope(x, inputs):
        return slopes(x, inputs, p.T).full()

    def work():
        x = x0.T
        for each in u:
            for _ in range(SUBSTEPS):
                k1 = slope(x, each.T)
                k2 = slope(x + h / 2 * k1, each.T)
                k3 = slope(x + h / 2 * k2, each.T)
                x = x + h / 6 * (k1 + 2 * (k2 + k3) + slope(x + h * k3, each.T))
        return x.T

    return work, RUNS * STEPS


ROWS = [
    Row(
        "CasADi: function as plant",
        "run-step",
        through_adapter,
        plain,
        "the function mapped over the runs, in a plain loop",
        1e-12,
    )
]
