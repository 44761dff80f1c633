"""Systems of python-control as plants: a step of the plant, and `dynamics` in a plain Runge-Kutta loop."""

import numpy as np

from perf.row import Row

RUNS, STEPS, TS, SUBSTEPS = 50, 20, 3.0, 10


def given():
    """Return the initial state of every run, and inputs (steps, runs, nu)."""
    rng = np.random.default_rng(0)
    return rng.uniform(0.05, 0.2, (RUNS, 2)), rng.uniform(5.0, 10.0, (STEPS, RUNS, 1))


def through_adapter(system, wide):
    """Return what simulates the plant; `wide` pads the states of the tanks for a system with an actuator."""

    def prepare():
        from rmpc_bench.adapters.control import plant
        from rmpc_bench.plants.ode_stepping import Solver

        made = plant(TS, STEPS, control=system(), solver=Solver(substeps=SUBSTEPS), x0=wide(np.full(2, 0.1)))
        x0, u = given()
        delta = made.draw({name: np.full(RUNS, value) for name, value in made.nominal.items()}, [], STEPS)

        def work():
            x = wide(x0)
            for k in range(STEPS):
                x = made.step(k, delta, x, u[k], np.zeros_like(x)).x
            return x

        return work, RUNS * STEPS

    return prepare


def plain(system, wide):
    """Return what calls `dynamics` run by run."""

    def prepare():
        made, (x0, u), h = system(), given(), TS / SUBSTEPS
        # The parameters of a run, which every call needs.
        p = dict(made.params)

        def one_run(x, inputs):
            for each in inputs:
                for _ in range(SUBSTEPS):
                    k1 = made.dynamics(0.0, x, each, p)
                    k2 = made.dynamics(0.0, x + h / 2 * k1, each, p)
                    k3 = made.dynamics(0.0, x + h / 2 * k2, each, p)
                    x = x + h / 6 * (k1 + 2 * (k2 + k3) + made.dynamics(0.0, x + h * k3, each, p))
            return x

        def work():
            return np.array([one_run(wide(x0)[i], u[:, i]) for i in range(RUNS)])

        return work, RUNS * STEPS

    return prepare


def tanks():
    """Two tanks, whose functions of NumPy take a block of runs."""
    from adapters.control_systems import tanks as made

    return made()


def interconnected():
    """The tanks with a slow pump, a system of systems, which takes one run at a time."""
    from adapters.control_systems import with_actuator

    return with_actuator()


def same(x):
    """Two states."""
    return x


def with_flow(x):
    """The flow of the pump as a third state."""
    return np.concatenate([x, np.full((*x.shape[:-1], 1), 8.0)], axis=-1)


def row(name, system, wide):
    """Return a row of the table."""
    return Row(
        f"python-control: {name}",
        "run-step",
        through_adapter(system, wide),
        plain(system, wide),
        "`dynamics` of python-control in a plain loop",
        1e-12,
    )


ROWS = [row("nonlinear system", tanks, same), row("interconnected system", interconnected, with_flow)]
