"""Every registered plant passes the checks of rmpc_bench.conformance."""

import math

import numpy as np
import pytest

from rmpc_bench import registry
from rmpc_bench.conformance import PlantExample, check_component
from rmpc_bench.extras import NEEDED_BY, is_installed
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.plants.uncertain_linear import Uncertainty

# Recorded runs are those of files, and do not follow u: tests/plants/test_data.py.
# A co-simulation unit is a file with compiled code: tests/adapters/test_fmu.py.
KINDS = [kind for kind in registry.names("plants") if kind not in ("data", "fmu")]


def casadi_pendulum():
    """The same as a function of CasADi."""
    import casadi

    x, u, p = casadi.SX.sym("x", 3), casadi.SX.sym("u", 2), casadi.SX.sym("p")
    change = [x[1], -casadi.sin(x[0]) - p * x[1] + 0.1 * u[0], casadi.tanh(x[0]) - x[2] + 0.1 * u[1]]
    return casadi.Function("pendulum", [x, u, p], [casadi.vcat(change)])


def casadi_friction():
    """A differential-algebraic equation: the velocity z at which friction balances a force."""
    import casadi

    x, u, z = casadi.SX.sym("x"), casadi.SX.sym("u"), casadi.SX.sym("z")
    return {"x": x, "u": u, "z": z, "ode": z - x, "alg": z + z**3 - u}


def pendulum(x, u, p):
    """Time derivatives of a damped pendulum with a torque and a disturbed second body."""
    return [x[1], -np.sin(x[0]) - p.d * x[1] + 0.1 * u[0], np.tanh(x[0]) - x[2] + 0.1 * u[1]]


def one_output(x, p):
    """An output of one run at a time."""
    return [max(x[0], x[1])]


def swing(t, x, u, p):
    """Time derivatives that a block cannot have: of one run at a time."""
    return [(math.cos(t) - p.d * x[0] if x[0] > 0 else 1.0) + 0.1 * u[0]]


def oscillator(m=1.0, k=2.0, d=0.3):
    """A mass with a spring and a damper as a system of scipy.signal."""
    from scipy.signal import StateSpace

    return StateSpace([[0.0, 1.0], [-k / m, -d / m]], [[0.0], [1.0 / m]], [[1.0, 0.0]], [[0.0]])


def named_oscillator(m=1.0, k=2.0):
    """The same as a system of python-control."""
    import control

    names = {"states": ["s", "v"], "inputs": ["force"], "outputs": ["place"]}
    return control.ss([[0.0, 1.0], [-k / m, 0.0]], [[0.0], [1.0 / m]], [[1.0, 0.0]], [[0.0]], **names)


def controlled_pendulum():
    """The pendulum as a system of python-control."""
    import control

    names = {"states": ["angle", "rate", "x3"], "inputs": ["torque", "force"], "outputs": ["first"]}
    return control.nlsys(updated, measured, params={"d": 0.3}, **names)


def updated(t, x, u, params):
    """Time derivatives of the pendulum as python-control calls them."""
    return [x[1], -np.sin(x[0]) - params["d"] * x[1] + 0.1 * u[0], np.tanh(x[0]) - x[2] + 0.1 * u[1]]


def measured(t, x, u, params):
    """Output of the pendulum as python-control calls it."""
    return [x[0]]


def discrete_pendulum():
    """A discrete system of python-control, all of whose states are measured, called run by run."""
    import control

    return control.nlsys(moved, None, states=2, inputs=1, params={"b": 0.01}, dt=0.1)


def moved(t, x, u, params):
    """Next state of a pendulum; math.sin takes one run at a time."""
    return [x[0] + 0.1 * x[1], x[1] - 0.1 * math.sin(x[0]) + params["b"] * u[0]]


STEPS = 10
UNCERTAIN = {
    "n_steps": STEPS, "A": [[0.5, 1.0, 0.1], [0.0, 0.3, -1.0], [0.2, 0.0, 0.9]],
    "B": [[1.0, 0.5], [0.0, 1.0], [-1.0, 2.0]], "C": [[1.0, 2.0, -1.0], [0.0, 1.0, 0.3]],
    "Bw": 1.5, "Bv": [[0.1, 0.2], [0.3, 0.0], [0.7, -0.1]],
    "Dw": [[0.3, 0.1, -0.9], [1.0, 0.0, 0.3]], "Dv": [[2.0, 0.0], [0.0, lambda at: 1.0 + at["k"]]],
    "H_A": [[0.1, 0.3], [0.7, -0.1], [0.2, 0.2]], "H_C": [[0.1, 0.9], [0.3, -0.4]],
    "G_x": [[1.0, 0.3, 0.1], [0.1, 0.7, 0.3], [0.9, -0.2, 0.4]],
    "H_Bw": [[0.1], [0.2], [0.3]], "H_Dw": [[0.7], [0.1]], "G_w": [[0.1, lambda at: 0.1 * at["k"], 0.3]],
    "H_Bv": 0.3, "H_Dv": [[0.1, 0.7, 0.2], [0.3, 0.1, 0.9]], "G_v": [[0.9, 0.1], [0.3, 0.7]],
}  # fmt: skip
PARAMETERS = {
    "env": [
        {"n_steps": STEPS, "env": "Pendulum-v1", "state": "state", "parameters": {"m": 1.0, "g": 10.0}},
        {"n_steps": STEPS, "env": "Pendulum-v1", "state": "state", "start": "initial", "output": ["x.1"]},
        {"n_steps": STEPS, "env": "MountainCarContinuous-v0", "output": ["observation.1", "x.0"]},
        {"n_steps": STEPS, "env": "CartPole-v1", "state": "state", "action": [-10.0, 10.0], "terminated": "ignore"},
    ],
    "casadi": [
        {"n_steps": STEPS, "casadi": casadi_pendulum, "parameters": {"d": 0.3}},
        {"n_steps": STEPS, "casadi": casadi_friction},
    ],
    "control": [
        {"n_steps": STEPS, "control": named_oscillator},
        {"n_steps": STEPS, "control": named_oscillator, "bounds": {"force": (-1.0, 1.0)}},
        {"n_steps": STEPS, "control": controlled_pendulum},
        {"n_steps": STEPS, "control": discrete_pendulum},
    ],
    "linear": [
        {"n_steps": STEPS, "A": 0.9, "B": 1.0, "C": 1.0},
        {
            "n_steps": STEPS,
            "A": [[0.5, lambda at: 0.1 * at["k"]], [0.0, 0.9]],
            "B": [[1.0], [0.3]],
            "C": [[0.2, 1.0], [1.0, 0.0], [0.3, 0.1]],
        },  # fmt: skip
    ],
    "moving-slide": [{}, {"substeps": 1, "mass": 2.0}],
    "ode": [
        {"n_steps": STEPS, "ode": pendulum, "states": 3, "inputs": 2, "parameters": {"d": 0.3}},
        {"n_steps": STEPS, "ode": swing, "states": 1, "inputs": 1, "parameters": {"d": 0.3}},
        {
            "n_steps": STEPS,
            "ode": pendulum,
            "states": 3,
            "inputs": 2,
            "parameters": {"d": 0.3},
            "output": one_output,
            "outputs": 1,
            "solver": Solver("LSODA"),
        },
    ],
    "scipy": [{"n_steps": STEPS, "scipy": oscillator}, {"n_steps": STEPS, "scipy": lambda: oscillator(2.0)}],
    "servo": [{}, {"alpha_l0": 0.0, "alpha_l1": 0.0}],
    "servo-linear": [{}],
    "uncertain-linear": [
        {"n_steps": STEPS, "A": 0.9, "B": 1.0, "C": 1.0, "Bw": 1.0, "H_A": 0.1, "H_C": 0.2, "G_x": 1.0},
        UNCERTAIN,
        UNCERTAIN | {"uncertainty": Uncertainty("extremes", -0.3, 0.7, per="run")},
        UNCERTAIN | {"uncertainty": Uncertainty("fixed", value={"x": -1.0})},
    ],
}
"""Parameters that make a design of each kind; a new kind gets a line here."""
SIZES = {"moving-slide": 0.005}
"""Of start, inputs and noises, where 1 would leave what a plant is made for."""


def case(kind, number):
    """Return a case; it is skipped where the library of the kind is not installed."""
    extra = NEEDED_BY.get(("plants", kind))
    without = extra is not None and not is_installed(extra)
    return pytest.param(kind, number, marks=pytest.mark.skipif(without, reason=f"needs the extra {extra}"))


CASES = [case(kind, number) for kind in KINDS for number in range(len(PARAMETERS.get(kind, [])))]


def test_every_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


@pytest.mark.parametrize(("kind", "number"), CASES)
def test_conformance(kind, number):
    """Oracle: the rules of a plant, with the sampling time it was designed for."""
    plant = registry.get("plants", kind)(0.1, **PARAMETERS[kind][number])
    example = PlantExample.random(plant, n_steps=STEPS, scale=SIZES.get(kind, 1.0))
    assert [str(result) for result in check_component(plant, example) if result.status == "failed"] == []
    assert plant.Ts == 0.1
