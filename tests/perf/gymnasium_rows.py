"""Environments of Gymnasium: the plant `env` in the simulation, and `step` of the environment in a plain loop.

The time of the simulation contains an estimator that returns 0 and a controller that returns given inputs.
"""

import numpy as np

from perf.row import Row

RUNS, STEPS = 50, 200


def torques():
    """Return inputs (runs, steps, 1) within the limits."""
    return np.random.default_rng(0).uniform(-2.0, 2.0, (RUNS, STEPS, 1))


def plant():
    """Simulate Pendulum-v1 with process noise and measurement noise 0, as a block of runs."""
    from rmpc_bench import registry
    from rmpc_bench.conformance.plants import no_estimate
    from rmpc_bench.conformance.systems import Excitation
    from rmpc_bench.simulation.closed_loop import simulate
    from rmpc_bench.simulation.reference import Constant
    from rmpc_bench.simulation.run_start import RunStart
    from rmpc_bench.simulation.scenario import Scenario
    from rmpc_bench.types import Journal, Method

    made = registry.get("plants", "env")(0.05, STEPS, env="Pendulum-v1", state="state")
    scenario = Scenario(1, {}, {}, np.zeros(2), (), (), (), Constant(np.zeros(2)))
    method = Method("open", no_estimate(2), Excitation(torques()))
    draws, r = scenario.draw(made, range(RUNS), STEPS), np.zeros((STEPS + 1, 2))

    def work():
        start = RunStart(1, tuple(range(RUNS)), Journal())
        record, _ = simulate(made, method, draws, r, STEPS, start=start)
        return record.x[:, -1]

    return work, RUNS * STEPS


def plain():
    """Make an environment per run and call its `step`."""
    import gymnasium

    from rmpc_bench.simulation.random_streams import stream

    u = torques()

    def one_run(run):
        made = gymnasium.make("Pendulum-v1").unwrapped
        made.reset(seed=int(stream(1, run, "own/plant").integers(2**31)))
        for k in range(STEPS):
            made.step(u[run, k])
        return made.state

    def work():
        return np.array([one_run(run) for run in range(RUNS)])

    return work, RUNS * STEPS


ROWS = [
    Row(
        "Gymnasium: Pendulum-v1 as plant",
        "run-step",
        plant,
        plain,
        "`step` of Pendulum-v1 in a plain loop",
        1e-12,
    )
]
