"""Every registered controller passes the checks of rmpc_bench.conformance."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
from conftest import random_model
from optional_libraries import skip_without_library

from rmpc_bench import registry
from rmpc_bench.conformance import ControllerExample, check_component
from rmpc_bench.conformance.controllers import ControllerInformationExample
from rmpc_bench.conformance.results import run_checks
from rmpc_bench.conformance.stages import Setting
from rmpc_bench.conformance.subject import subject_of
from rmpc_bench.conformance.systems import LinearSystem
from rmpc_bench.controllers.limits import InputLimits, Limits
from rmpc_bench.controllers.mpc import Scale
from rmpc_bench.controllers.noise_tuning import LpNoise
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.kalman_disturbance import design as kalman_disturbance
from rmpc_bench.estimators.set_membership import design as set_membership
from rmpc_bench.types import Controller

KINDS = registry.names("controllers")
TUBE = {"Q_x": 1.0, "R_u": 0.1, "horizon": 5, "limits": {"u": (-0.4, 0.4), "x.0": (-3.0, 3.0)}, "W": 0.01}
PARAMETERS = {
    "gpc": [
        {"Np": 4, "Q_yw": 1.0, "Q_u": 0.1},
        {"Np": 4, "Q_yw": 1.0, "Q_u": 0.1, "tuning": LpNoise(Ne2=4, kp=0.3)},
        {"Np": 2, "Q_yw": 1.0, "Q_u": 0.1, "tuning": LpNoise(Ne2=4, kp=0.3, on="residual", weight="square")},
        {"Np": 4, "Q_yw": 1.0, "Q_u": 0.1, "of": "mean"},
        {"Np": 4, "Q_yw": 1.0, "Q_u": 0.1, "tuning": LpNoise(Ne2=4, kp=0.3), "of": "mean"},
        {"Np": 3, "Q_yw": 1.0, "Q_u": 0.1, "tuning": LpNoise(Ne2=4, kp=0.3, on="none")},
    ],
    "mpc": [
        {"Hp": 6, "Hu": 2, "Q": 1.0, "R": 0.1, "limits": Limits(u=(-0.3, 0.3))},
        {"Hp": 3, "Hu": 3, "Q": 1.0, "R": 0.1, "scale": Scale(u=2.0, y=3.0)},
        {"Hp": 4, "Hu": 2, "Q": 1.0, "R": 0.1, "law": "printed"},
        {"Hp": 6, "Hu": 2, "Q": 1.0, "R": 0.1, "of": "mean"},
    ],
    "minimax-lq": [
        {"horizon": 7, "Q_x": 1.0, "R_u": 0.1},
        {"horizon": 5, "Q_x": 1.0, "R_u": 0.1, "set": "product"},
        {"horizon": 2, "Q_x": 1.0, "R_u": 0.1, "set": "stages"},
        {"horizon": 4, "Q_x": 1.0, "R_u": 0.1, "of": "data"},
    ],
    "lqr": [
        {"horizon": 7, "Q_x": 1.0, "R_u": 0.1},
        {"horizon": 7, "Q_x": 1.0, "R_u": 0.1, "mean": "estimated", "of": "mean"},
        {"horizon": 7, "Q_x": 1.0, "R_u": 0.1, "limits": InputLimits(u=(-0.3, 0.3))},
    ],
    "control-lqr": [{"Q_x": 1.0, "R_u": 0.1}],
    "game-gain": [{"horizon": 7, "Q_x": 1.0, "R_u": 0.1, "ratio": 1.5}],
    "lqg": [
        {"Q_x": 1.0, "Q_i": 0.1, "R_u": 0.1, "limits": InputLimits((-0.3, 0.3))},
        {"Q_y": 1.0, "Q_i": 0.0, "R_u": 0.1, "of": "mean"},
        {"Q_x": 1.0, "Q_i": 0.1, "R_u": 0.1, "on": "estimate", "feedforward": "none"},
        {"Q_x": 1.0, "Q_i": 0.1, "R_u": 0.1, "limits": InputLimits((-0.3, 0.3)), "anti_windup": "back-calculation"},
    ],
    "pid": [
        {"Kp": 1.0, "Ki": 0.5, "Kd": 0.2, "Tf": 0.1, "limits": InputLimits((-0.3, 0.3))},
        {"Kp": 1.0, "Ki": 0.5, "on": "estimate", "start": "bumpless"},
        {"Kp": 1.0, "Ki": 0.5, "limits": InputLimits((-0.3, 0.3)), "anti_windup": "clamping"},
    ],
    "tube-mpc": [
        {**TUBE, "tightening": "growing"},
        {**TUBE, "tightening": "growing", "fallback": "hold"},
        {**TUBE, "tightening": "none", "fallback": "stop", "limits": {"u": (-9.0, 9.0)}},
        {**TUBE, "tightening": "tube", "alpha": 0.3},
    ],
}
"""Parameters that make a design of each kind, `of` a filter if not a Kalman filter's; a new kind gets a line here."""
SIZES = [(1, 1, 1), (3, 2, 2), (4, 1, 2)]
# The set of a tube has too many facets with four states.
CASES = [
    # The set `stages` takes a search of milliseconds per run and step.
    pytest.param((kind, number, size), marks=[pytest.mark.slow] * (parameters.get("set") == "stages"))
    for kind in KINDS
    for number, parameters in enumerate(PARAMETERS.get(kind, []))
    for size in (SIZES[1:2] if parameters.get("set") == "stages" else SIZES[:2] if "alpha" in parameters else SIZES)
]
RUNS, STEPS = 9, 12


def test_every_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}-{case[1]}-{''.join(map(str, case[2]))}")
def case(request):
    """Return a design with the data to check it with, and the number of inputs."""
    kind, number, (nx, nu, ny) = request.param
    skip_without_library("controllers", kind)
    model = random_model(np.random.default_rng(12), nx, nu, ny, 0.9)
    make, provided, parameters = registry.get("controllers", kind), {}, dict(PARAMETERS[kind][number])
    if kind in ("lqg", "pid"):
        provided["Ts"] = 0.1
        if ny != nu:
            # One output per input.
            parameters["outputs"] = list(range(nu))
    if "estimator" in inspect.signature(make).parameters:
        start = {"x0": np.zeros(nx), "P0": np.eye(nx)}
        filter_of = {"data": data_dependent, "mean": kalman_disturbance}.get(parameters.pop("of", ""), kalman)
        given = {"n_steps": STEPS, "estimator": filter_of(model, STEPS, **start)}
        provided |= {name: value for name, value in given.items() if name in inspect.signature(make).parameters}
    design = make(model, **provided, **parameters)
    return design, ControllerExample.random(nx, ny, design.preview, n_runs=RUNS, n_steps=STEPS), nu


def data_dependent(model, n_steps, **start):
    """A filter with a set of its own for every run."""
    return set_membership(model, n_steps, **start, M0=np.eye(model.nx), update="maksarov-norton")


def test_conformance(case):
    """Oracle: the rules of a controller; u has the model's inputs."""
    design, example, nu = case
    assert [str(result) for result in check_component(design, example) if result.status == "failed"] == []
    assert example.u(design).shape == (RUNS, STEPS, nu)


@pytest.mark.parametrize("kind", KINDS)
def test_available_information(kind):
    """Every controller uses the data up to k and the reference of its preview only."""
    skip_without_library("controllers", kind)
    system = replace(LinearSystem.shipped(), n_runs=6, n_steps=100)
    make, given = registry.get("controllers", kind), {"n_steps": system.n_steps, "estimator": system.kalman, "Ts": 0.1}
    provided = {name: value for name, value in given.items() if name in inspect.signature(make).parameters}
    design = make(system.model, **provided, **PARAMETERS[kind][0])
    example = ControllerInformationExample(system, design.preview, design.regulates)
    results = run_checks(ControllerInformationExample.checks, design, example)
    assert [str(each) for each in results if each.status == "failed"] == []
    assert "passed" in {each.status for each in results}


MEMORIES = {
    "pid": {"Kp": 1.0, "Ki": 0.5},
    "lqg": {"Q_x": 1.0, "Q_i": 0.1, "R_u": 0.1, "anti_windup": "back-calculation"},
    "mpc": {"Hp": 6, "Hu": 2, "Q": 1.0, "R": 0.1, "limits": {"du": (-0.2, 0.2)}},
}
"""Keys of laws that remember the input that acts."""


@pytest.mark.parametrize("kind", MEMORIES)
def test_a_law_that_forgets_the_input_that_acts_is_named(kind, monkeypatch):
    """Oracle: the law with limits of its own; without the hook the law remembers what it has returned."""
    system = replace(LinearSystem.shipped(), n_runs=9, n_steps=STEPS)
    setting = Setting(subject_of(kind, "controllers", MEMORIES[kind]), "controllers", system)
    free, limited = setting.limited_pair()
    assert (free.input_limits in (None, (-np.inf, np.inf)), limited.input_limits) == (True, (-0.3, 0.3))
    example = replace(ControllerExample.random(2, 1, free.preview, n_steps=STEPS), pair=(free, limited))

    def applied():
        return next(each for each in check_component(free, example) if each.id == "applied-input")

    assert applied().status == "passed"
    monkeypatch.setattr(type(free), "applied", Controller.applied)
    assert applied().status == "failed" and "equal limits of its own" in applied().reason
