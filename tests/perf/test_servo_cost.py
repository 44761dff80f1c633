"""What accuracy of the servomechanism costs: methods, errors and times, as a table of `pytest -m perf` of this file.

Cases: 400 closed loops of Fig. 7 (200 plants with S-MPC and with R-MPC1), their voltages replayed over 200 samples.
Error: the largest |dy| over all samples and loops against the collocation reference of `servo_reference`.
Time: of moving the plant for 200 runs x 4 methods x 200 samples on one core, in blocks of 50 runs, once compiled; the
methods take turns, and the least of the rounds counts.
"""

from time import perf_counter

import numpy as np
import pytest
from plants.first_order import first_order, runge_kutta
from plants.servo_loops import ReferencePlant, fig7
from plants.servo_reference import FINE, held

from rmpc_bench.models.servo_compiled import TOLERANCE
from rmpc_bench.plants import servo
from rmpc_bench.simulation.closed_loop import simulate

pytestmark = pytest.mark.perf

METHODS, BLOCK, RUNS, ROUNDS, JUDGED = ("S-MPC", "R-MPC1", "R-MPC2", "R-MPC3"), 50, 200, 5, ("S-MPC", "R-MPC1")


def taylor(rows, Ts, tolerance):
    """Return (x, u) -> x after a sample by the plant's kernel with a tolerance."""
    from rmpc_bench.models.servo_compiled import compiled_servo, servo_step

    made = np.stack([servo.coefficients(p) for p in rows])
    plant, no_noise = compiled_servo(made, Ts, tolerance), np.zeros((len(rows), 4))
    return lambda x, u: servo_step(plant, x, u, no_noise)[0]


SCHEMES = {
    "RK4 of the sgn equation, 2 ms": (runge_kutta, 2e-3),
    "first order, 2 ms": (first_order, 2e-3),
    "first order, 1 ms": (first_order, 1e-3),
    "Taylor, tolerance 1e-9": (taylor, 1e-9),
    f"Taylor, tolerance {TOLERANCE:.0e} (the plant)": (taylor, TOLERANCE),
}


def loops():
    """Parameters of the runs, and the voltages (runs, samples) of each method's closed loops."""
    experiment, volts = fig7(), {}
    rows = experiment.scenario.draw(ReferencePlant(), range(RUNS), 1).delta
    for name in METHODS:
        method = experiment.method(name)
        draws = experiment.scenario.draw(experiment.plant, range(RUNS), experiment.n_steps)
        r = experiment.scenario.reference.sample(experiment.n_steps + 1 + method.controller.preview)
        volts[name] = simulate(experiment.plant, method, draws, r, experiment.n_steps)[0].u[:, :, 0]
    return rows, volts


def angles(scheme, parameter, rows, volts):
    """Load angles (runs, samples) and the time of moving the plant [s]."""
    y, elapsed = np.zeros((len(rows), volts.shape[1] + 1)), 0.0
    for first in range(0, len(rows), BLOCK):
        block = slice(first, first + BLOCK)
        step, u = scheme(rows[block], 0.1, parameter), np.ascontiguousarray(volts[block].T)[:, :, None]
        x = np.zeros((u.shape[1], 5))
        start = perf_counter()
        for k in range(len(u)):
            x = step(x, u[k])
            y[block, k + 1] = x[:, 0]
        elapsed += perf_counter() - start
    return y, elapsed


def test_accuracy_and_cost(capsys):
    """Prints the table; asserts what the plant promises of its accuracy and nothing of time."""
    rows, volts = loops()
    references = {
        name: [held(p, u, tolerance=FINE)[0][:, 0] for p, u in zip(rows, volts[name], strict=True)] for name in JUDGED
    }
    errors, times = {}, {label: np.inf for label in SCHEMES}
    for label, scheme in SCHEMES.items():  # this round compiles, too
        errors[label] = max(np.abs(angles(*scheme, rows, volts[m])[0] - references[m]).max() for m in JUDGED)
    for _ in range(ROUNDS):
        for label, scheme in SCHEMES.items():
            times[label] = min(times[label], sum(angles(*scheme, rows, volts[name])[1] for name in METHODS))
    with capsys.disabled():
        print(f"\n{'servomechanism, one core':42}{'max |dy| [rad]':>16}{'200 x 4 x 200 [s]':>20}")
        for label in SCHEMES:
            print(f"{label:42}{errors[label]:16.1e}{times[label]:20.3f}")
    *_, ours = SCHEMES
    assert errors[ours] <= 1e-11
