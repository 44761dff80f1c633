"""configs/servo-constrained: runs of the package and of a second program with quadprog, on the same plants."""

import numpy as np
import pytest
from papers.constrained_twin import K_THETA, RHO, TORQUE_MAX, Law, model, simulate

from rmpc_bench import load_config, run
from rmpc_bench.simulation.closed_loop import simulate as simulate_closed_loop
from rmpc_bench.types import OptimisedStep

CONFIG = "configs/servo-constrained/clip-against-qp.yaml"
N_RUNS, N_STEPS = 3, 200
LOOPS = {
    "S qp": (None, 0.0, None),
    "S light": (None, 0.0, 0.001),
    "S exact": (None, 0.0, 0.03),
    "S+input qp": ("input", 1e5, None),
    "S+input exact": ("input", 1e5, 0.03),
}
"""Method -> place and drift of its disturbance, and the linear penalty of the torque."""


@pytest.fixture(scope="module")
def experiment():
    """The experiment with a few runs."""
    return load_config(CONFIG, runs=N_RUNS)


@pytest.fixture(scope="module")
def trials(experiment, tmp_path_factory):
    return run(experiment, directory=tmp_path_factory.mktemp("trials"), jobs=1, only=[*LOOPS]).trials


@pytest.fixture(scope="module")
def plants(experiment):
    """Function that moves the true plant of a run by one sample, and its draws."""
    parts = experiment.experiment
    draws = parts.scenario.draw(parts.plant, range(N_RUNS), N_STEPS)

    def step(i, k):
        def of_run(x, u):
            everyone = np.tile(x, (N_RUNS, 1))
            return parts.plant.step(k, draws.delta, everyone, np.full((N_RUNS, 1), u), draws.w[:, k]).x[i]

        return of_run

    return draws, step


@pytest.mark.parametrize("method", LOOPS)
def test_the_second_program_has_the_same_errors(method, trials, plants):
    """Oracle: filter, prediction and quadratic program written a second time, with quadprog and explicit slacks."""
    at, drift, linear = LOOPS[method]
    m, (draws, step) = model(at, drift), plants
    for i in range(N_RUNS):
        y = simulate(step(i, 0), draws.x0[i], m, Law(m, linear), N_STEPS).y
        mse = np.mean((y[:-1] - np.pi / 2) ** 2)
        assert trials.column("mse", method)[i] == pytest.approx(mse, rel=1e-6), i
        assert trials.column("runaway", method)[i] == (np.abs(y).max() > np.pi), i


def test_the_largest_multiplier_of_the_hard_limit():
    """Nominal plant without noise: a larger penalty makes the soft limit exact, a smaller one does not."""
    m = model()
    largest = {}
    for linear in (np.inf, 0.0208, 0.0205):
        law = Law(m, linear)
        x, torque = [np.zeros(4)], []

        def step(x, u, torque=torque):
            x = m.A @ x + m.B * u
            torque.append(abs(m.Z @ x))
            return x

        simulate(step, x[0], m, law, 100)
        largest[linear] = max(torque), law.multiplier
    assert largest[np.inf][1] == pytest.approx(0.02072, abs=5e-6)
    assert largest[0.0208][0] == pytest.approx(TORQUE_MAX, rel=1e-9)
    assert largest[0.0205][0] == pytest.approx(78.584, abs=5e-4)


def test_a_limit_in_the_torque_of_the_motor_would_never_act():
    """The trap of two definitions: the torque on the motor is 20 times smaller."""
    m = model()
    torque = []

    def step(x, u):
        x = m.A @ x + m.B * u
        torque.append(K_THETA * (x[2] / RHO - x[0]))
        return x

    simulate(step, np.zeros(4), m, Law(m), 100)
    assert max(map(abs, torque)) > 1.5 * TORQUE_MAX > TORQUE_MAX > 10 * max(map(abs, torque)) / RHO


def test_multipliers_on_the_perturbed_plants():
    """A few states need a larger penalty than 0.03; almost all programs with a slack are those that no input can meet.

    Oracle: the program with a hard limit of the torque, which has no solution or has multipliers.
    """
    parts, n = load_config(CONFIG, runs=30).experiment, 60
    draws, r = parts.scenario.draw(parts.plant, range(30), n), parts.scenario.reference.sample(n + 20)
    record, _ = simulate_closed_loop(parts.plant, parts.method("S exact"), draws, r, n, info={"qp"})
    law, largest, softened, without = Law(model(), np.inf), [], 0, 0
    for i, k in np.argwhere(record.info["qp"][:, :, 0] > 0.0):
        law.multiplier = 0.0
        has_slack = record.info["qp"][i, k, 0] == OptimisedStep.SOFTENED
        softened += has_slack
        try:
            law.first_move(record.x_hat[i, k], record.u[i, k - 1, 0] if k else 0.0)
        except ValueError:
            without += 1
            assert has_slack
        else:
            largest.append(law.multiplier)
            assert has_slack == (law.multiplier > 0.03)
    # 543 programs with multipliers, 6 of them larger than 0.03, and 178 without a solution.
    assert len(largest) > 500 and 0.0 < np.mean(np.array(largest) > 0.03) < 0.02
    assert max(largest) == pytest.approx(0.153, abs=1e-3)
    assert 0.95 * softened < without < softened
