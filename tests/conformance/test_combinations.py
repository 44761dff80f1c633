"""Every estimator with every controller, on a linear and a nonlinear plant, with delays, slow sensors and gaps.

`combinations.txt` has what is expected of every cell: `.` for five runs that reach their end, or the letter of a design
error of `ERRORS`.  Nothing is silent: a cell that neither runs nor names its error fails.
"""

from pathlib import Path

import numpy as np
import pytest
from conftest import EVERY, TURN, by_turn
from required_keys import REQUIRED

from rmpc_bench import registry
from rmpc_bench.config.load import load_config
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.types import ConfigError, Status

EXPECTED = Path(__file__).with_name("combinations.txt")
RUNS, STEPS = 5, 16
RHS = '''
def rhs(x, u, p):
    """A damped spring whose force grows with the cube of the position."""
    return [x[1], u[0] - x[0] - 0.3 * x[0] ** 3 - 0.5 * x[1]]


def output(x, p):
    """The position."""
    return [x[0]]
'''
A, B, C = [[1, 0.1], [-0.1, 0.95]], [[0.005], [0.1]], [[1, 0]]
NOISE = {"P_w": [1e-6, 1e-4], "P_v": 1e-4}
MODELS = {
    "": {"kind": "linear", "A": A, "B": B, "C": C, **NOISE},
    "sets": {"kind": "linear", "A": A, "B": B, "C": C, **NOISE, "M_w": [1e-6, 1e-4], "M_v": 1e-4},
    "uncertain": {"kind": "uncertain-linear", "A": A, "B": B, "C": C, "Bw": 1.0, "Dv": 1, "H_A": [[0], [0.02]],
                  "G_x": [[1, 0]], "H_C": [[0.01]], "H_Dv": [[0.1]], "G_v": [[1]], "W": [1e-6, 1e-4], "V": 1e-4},
    "nonlinear": {"nonlinear": "plant", "at": {"x": [0, 0], "u": 0},
                  "noise": {"process": [1e-6, 1e-4], "measurement": 1e-4}},
}  # fmt: skip
PLANTS = {
    "linear": {name: value for name, value in MODELS["uncertain"].items() if name not in "WV"}
    | {"uncertainty": {"law": "uniform", "low": -1, "high": 1}},
    "nonlinear": {
        "ode": "spring.py:rhs",
        "output": "spring.py:output",
        "states": ["p", "v"],
        "inputs": ["f"],
        "outputs": ["position"],
    },
}
ESTIMATORS = REQUIRED | {
    "directional-kalman": {"q": 1e-4, "direction": [0, 1]},
    "h-infinity": {"fraction": 0.3},
    "robust-kalman": {"c": 1e-3},
    "wasserstein-kalman": {"radius": 1e-3},
    "moving-horizon": {"window": 4},
    "nonlinear-moving-horizon": {"window": 4},
}
"""Keys that a kind needs."""
MODEL_OF = {
    **dict.fromkeys(("mixed", "set-membership"), "sets"),
    **dict.fromkeys(("enhanced-robust", "lmmse", "oracle", "sayed-bdu"), "uncertain"),
    **dict.fromkeys(("extended-kalman", "nonlinear-moving-horizon", "unscented-kalman"), "nonlinear"),
}
QUADRATIC = {"Q_x": 1, "R_u": 0.1}
CONTROLLERS = {
    "control-lqr": QUADRATIC,
    "game-gain": {**QUADRATIC, "horizon": 5, "ratio": 1e4},
    "gpc": {"Np": 4, "Q_yw": 1, "Q_u": 0.1},
    "lqg": {**QUADRATIC, "Q_i": 0.1},
    "lqr": {**QUADRATIC, "horizon": 5},
    "minimax-lq": {**QUADRATIC, "horizon": 3},
    "mpc": {"Hp": 6, "Hu": 2, "Q": 1, "R": 0.1, "limits": {"u": [-1, 1]}},
    "pid": {"Kp": 1, "Ki": 0.2, "Kd": 0.1, "on": "estimate"},
    "tube-mpc": {
        **QUADRATIC,
        "horizon": 4,
        "limits": {"u": [-5, 5], "x.0": [-9, 9]},
        "W": 0.01,
        "tightening": "growing",
    },
}
GAUSSIAN = {"gaussian": {"std": 0.01}}
SCENARIOS = {
    "none": {},
    "input delay 1": {"input": {"delayed": 1}},
    "measurement delay 2": {"measurement": {"sum": [GAUSSIAN, {"delayed": 2}]}},
    "every 4": {"measurement": {"sum": [GAUSSIAN, {"missing": {"every": 4}}]}},
    "missing 20 %": {"measurement": {"sum": [GAUSSIAN, {"missing": {"probability": 0.2}}]}},
}
NO_DELAY = "delay 0"
CHANNELS = {**SCENARIOS, NO_DELAY: {"input": {"delayed": 0}, "measurement": {"sum": [GAUSSIAN, {"delayed": 0}]}}}
ERRORS = {
    "S": "reports neither a set nor a covariance",
    "M": "does not support an estimated mean",
    "D": "needs a model without delay",
    "L": "needs the errors of a filter without late measurements",
    "U": "needs plant and model of a kind with uncertain matrices",
}
"""Letter -> words of the message."""


CELLS = [(estimator, controller) for estimator in registry.names("estimators") for controller in CONTROLLERS]


def config(plant, scenario, cells):
    """An experiment with a method for each of some cells."""
    return {
        "version": 1, "name": "cells", "seed": 3, "runs": RUNS, "time": {"step": 0.1, "steps": STEPS},
        "plant": PLANTS[plant], "initial": {"x": [0.3, 0], "x_hat": 0, "P": 0.1, "M": 0.1},
        "noise": {"process": {"gaussian": {"std": [1e-3, 1e-2]}}, "measurement": GAUSSIAN, **CHANNELS[scenario]},
        "reference": {"kind": "constant", "value": 0}, "figures": [],
        "metrics": ["mse", "estimation_mse", "input_power"],
        "methods": {
            f"{estimator} {controller}": {
                "model": {**MODELS[MODEL_OF.get(estimator, "")], "delay": "same"},
                "estimator": {"kind": estimator, **ESTIMATORS.get(estimator, {})},
                "controller": {"kind": controller, **CONTROLLERS[controller]},
            } for estimator, controller in cells
        },
    }  # fmt: skip


def loaded(plant, scenario, cells):
    """The experiment of the cells without error, and the first message of each of the others."""
    messages = {}
    while True:
        accepted = [cell for cell in cells if cell not in messages]
        try:
            return load_config(config(plant, scenario, accepted)).points[0].experiment, messages
        except ConfigError as error:
            found = {problem.path: problem.message for problem in error.problems}
            assert all(path.startswith("methods.") for path in found), str(error)
            messages = {
                tuple(path.split(".")[1].split()): message for path, message in reversed(found.items())
            } | messages


def outcome(status, message):
    """`.` for runs that reach their end, or the letter of a design error; everything else in words."""
    if message is None:
        return "." if (status == Status.OK).all() else f"{status}"
    return next((letter for letter, words in ERRORS.items() if words in message), message)


def expected():
    """(plant, scenario) -> estimator -> outcomes by controller."""
    tables, rows = {}, {}
    for line in EXPECTED.read_text("utf-8").splitlines():
        if line.startswith("["):
            plant, _, scenario = line.strip("[]").partition(": ")
            rows = tables.setdefault((plant, scenario), {})
        elif line and not line.startswith("#"):
            estimator, letters = line.split()
            rows[estimator] = letters
    return tables


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """A directory with the right-hand side."""
    (tmp_path / "spring.py").write_text(RHS, encoding="utf-8")
    monkeypatch.chdir(tmp_path)


def test_the_table_has_every_kind():
    """Oracle: the registry; kinds that were added later may be missing."""
    assert len(CONTROLLERS) >= 9 and set(CONTROLLERS) <= set(registry.names("controllers"))
    assert set(expected()) == {(plant, scenario) for plant in PLANTS for scenario in SCENARIOS}
    for rows in expected().values():
        assert len(rows) >= 26 and [*rows] == [kind for kind in registry.names("estimators") if kind in rows]
        assert {len(letters) for letters in rows.values()} == {len(CONTROLLERS)}


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("plant", PLANTS)
def test_every_kind_runs_or_names_its_error(plant, scenario):
    """Oracle: the table; some cells by turn, with `RMPC_BENCH_TESTS=all` all."""
    # A case runs at some turns only: without the last number it would have the same cells each time.
    cells = by_turn(CELLS, len(plant + scenario) + TURN // EVERY)
    experiment, messages = loaded(plant, scenario, cells)
    blocks = {method.name: simulate_block(experiment, method, range(RUNS)) for method in experiment.methods}
    found = {
        cell: outcome(None if cell in messages else blocks[" ".join(cell)].status, messages.get(cell)) for cell in cells
    }
    rows, laws = expected()[plant, scenario], [*CONTROLLERS]
    # A kind without a row does what a plain filter does, whose P is known before the runs or depends on the data.
    plain = (rows["fading-kalman"], rows["gated-kalman"])
    wrong = {
        (kind, law): what
        for (kind, law), what in found.items()
        if what not in {row[laws.index(law)] for row in ((rows[kind],) if kind in rows else plain)}
    }
    assert wrong == {} and [*found] == [*cells]


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.long
def test_no_delay_is_a_delay_of_zero_samples(plant):
    """Oracle: the same experiment without the laws, bit for bit."""
    cells = by_turn(CELLS, 7 + TURN // EVERY)
    (bare, messages), (delayed, same) = (loaded(plant, scenario, cells) for scenario in ("none", NO_DELAY))
    assert messages == same and [each.name for each in bare.methods] == [each.name for each in delayed.methods]
    for one, other in zip(bare.methods, delayed.methods, strict=True):
        found = [simulate_block(experiment, method, range(2)) for experiment, method in ((bare, one), (delayed, other))]
        np.testing.assert_array_equal(found[0].metrics, found[1].metrics, err_msg=one.name)
