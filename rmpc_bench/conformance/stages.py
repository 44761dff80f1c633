"""The checks of every kind of component, and what they are run on: a linear system, or the experiment of a user."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.controllers import FIRST as CONTROLLER_FIRST
from rmpc_bench.conformance.controllers import ControllerExample, ControllerInformationExample
from rmpc_bench.conformance.estimators import FIRST as ESTIMATOR_FIRST
from rmpc_bench.conformance.estimators import FUNCTION, EstimatorInformationExample, require_causal
from rmpc_bench.conformance.evaluation import FigureExample, MetricExample, example_record, example_results
from rmpc_bench.conformance.information import FRESH, InformationExample, SeparateProcess
from rmpc_bench.conformance.plants import FIRST as PLANT_FIRST
from rmpc_bench.conformance.plants import PlantExample
from rmpc_bench.conformance.results import Check, NotApplicableError, require
from rmpc_bench.conformance.signals import NoiseExample, ReferenceExample
from rmpc_bench.conformance.subject import Subject
from rmpc_bench.conformance.systems import EstimatorExample, LinearSystem, simulated
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Array, Controller, DesignError, Estimator, Plant, PlantInfo, as_estimate

N_RUNS, N_STEPS = 10, 150
"""Largest size of the simulation."""


class ExperimentSystem:
    """The plant, the scenario and a method of an experiment."""

    def __init__(self, experiment: Experiment, method: str) -> None:
        # The other methods and the metrics are not needed.
        self.experiment = replace(experiment, methods=(experiment.method(method),), metrics=())

    @property
    def n_steps(self) -> int:
        """Number of control periods."""
        return min(self.experiment.n_steps, N_STEPS)


System: TypeAlias = LinearSystem | ExperimentSystem
"""What a component is checked on."""


class Recording(Estimator):
    """An estimator that records its inputs and its estimates."""

    def __init__(self, design: Estimator) -> None:
        self.design = design
        self.y, self.u, self.x_hat = list[Array](), list[Array](), list[Array]()

    @property
    def starts_runs(self) -> bool:
        """As the estimator."""
        return self.design.starts_runs

    def init(self, *args: Any, **keywords: Any) -> Any:
        """Start the estimator."""
        return self.design.init(*args, **keywords)

    def correct(self, k: int, state: Any, y: Array) -> Any:
        """Keep y(k) and x_hat(k)."""
        self.y.append(y.copy())
        state, returned = self.design.correct(k, state, y)
        self.x_hat.append(np.array(as_estimate(returned).x_hat))
        return state, returned

    def predict(self, k: int, state: Any, u: Array) -> Any:
        """Keep u(k)."""
        self.u.append(u.copy())
        return self.design.predict(k, state, u)


@dataclass(frozen=True, eq=False)
class ExperimentExample(InformationExample):
    """Runs of an experiment that an estimator is checked on: its plant, scenario and method, and the design."""

    system: ExperimentSystem
    estimator: Estimator

    @cached_property
    def recording(self) -> Recording:
        """The estimator in the simulation with its controller; only runs that reach the last sample can be compared."""
        experiment, n_steps = self.system.experiment, self.system.n_steps
        [method], runs = experiment.methods, range(min(experiment.n_runs, N_RUNS))
        kept = Recording(self.estimator)
        draws = experiment.scenario.draw(experiment.plant, runs, n_steps)
        r = experiment.scenario.reference.sample(n_steps + 1 + method.preview)
        # Every call is recorded once: late measurements count when they arrive.
        method = method._replace(estimator=kept, delay=method.delay._replace(measurement=()))
        limit = experiment.state_range
        _, status = simulated(experiment.plant, method, draws, r, n_steps, state_range=limit)
        require(not status.any(), f"{int(status.astype(bool).sum())} of {len(status)} runs fail")
        return kept

    @cached_property
    def data(self) -> EstimatorExample:
        """The measurements and inputs alone."""
        return EstimatorExample(np.stack(self.recording.y, axis=1), np.stack(self.recording.u, axis=1))

    def simulated(self, component: Estimator) -> Float[Array, "runs samples nx"]:
        """Estimates in the simulation."""
        return np.stack(self.recording.x_hat, axis=1)


def _completes(estimator: Estimator, example: ExperimentExample) -> None:
    example.in_loop(estimator)


def _causal(estimator: Estimator, example: ExperimentExample) -> None:
    require_causal(estimator, example.data, change=example.system.n_steps // 2 + 1)


ExperimentExample.checks = (
    Check("no-exception", "every call returns without an exception", _completes, is_first=True),
    FUNCTION,
    FRESH,
    Check("causal", "x_hat(k) does not depend on y after k", _causal),
)


SHORT = 12
"""Steps of the random examples."""
LIMITS = {"u": (-0.3, 0.3)}
"""Limits of the input of a law that has such a key."""
NOISES = 2
"""Dimension of a noise."""


class Stage(NamedTuple):
    """Checks that are run on one example."""

    checks: tuple[Check, ...]
    component: Any = None
    example: Any = None


@dataclass(eq=False)
class Setting:
    """A component of a group of the registry, and the system that the bench provides to it."""

    subject: Subject
    group: str
    system: System
    seconds: float = 30.0  # time limit of one check

    @property
    def linear(self) -> LinearSystem:
        """The linear Gaussian system."""
        assert isinstance(self.system, LinearSystem)
        return self.system

    def made(self, n_steps: int) -> Any:
        """Make the design for a number of steps."""
        return self.subject.made(self.group, provided(self.group, self.system, n_steps))

    def limited_pair(self) -> tuple[Controller, Controller] | None:
        """Return a law without limits of its own and with some; None where its limits have another form, or none."""
        keys = {name: value for name, value in self.subject.keys.items() if name != "limits"}
        given = (replace(self.subject, keys=each, written=True) for each in (keys, {**keys, "limits": LIMITS}))
        try:
            free, limited = (replace(self, subject=each).made(SHORT) for each in given)
        # Limits of another form, or a law that has none, or none without them.
        except (DesignError, AttributeError, LookupError, TypeError, ValueError):
            return None
        return (free, limited) if limited.input_limits == LIMITS["u"] else None

    def separate_process(self, n_steps: int | None = None) -> SeparateProcess:
        """Return the component in another process, made for a number of steps (default: those of the system)."""
        given = provided(self.group, self.system, n_steps or self.system.n_steps)
        # It ends before the check does, which then says why.
        return SeparateProcess(self.subject, given, self.group, seconds=2 / 3 * self.seconds)


def provided(group: str, system: System, n_steps: int) -> Mapping[str, Any]:
    """Return what a design function may ask for."""
    if isinstance(system, ExperimentSystem):
        # The recipe of the component has what the experiment provides.
        return {}
    model = system.model
    start = {"x0": system.x0, "P0": system.P0, "M0": system.P0}
    common = {"Ts": system.plant.Ts, "n_steps": n_steps, "plant_info": PlantInfo.of(system.plant)}
    given: dict[str, Mapping[str, Any]] = {
        "estimators": {"model": model, **start, **common, "plant": system.plant},
        "controllers": {"model": model, "estimator": system.kalman, **common},
        "plants": {"Ts": 0.1, "n_steps": n_steps},
        "models": {"Ts": 0.1, "n_steps": n_steps},
        "references": {"ny": model.ny, "Ts": 0.1},
        "noises": {"n": NOISES, "Ts": 0.1},
    }
    return given.get(group, {})


MADE = Check("signature", "the design can be made", lambda component, example: None, is_first=True)
"""Comes first for every kind; fails where the design function raises."""


def _estimator_stages(setting: Setting) -> Iterator[Stage]:
    system = setting.linear
    design: Estimator = setting.made(system.n_steps)
    with setting.separate_process() as separate_process:
        example = EstimatorInformationExample(system, separate_process=separate_process)
        yield Stage((MADE,))
        if design.knows_uncertainty:
            yield Stage(ESTIMATOR_FIRST[:1], design, example.data)
            return
        yield Stage(ESTIMATOR_FIRST, design, example.data)
        data = EstimatorExample.random(system.model.nu, system.model.ny, n_steps=SHORT)
        yield Stage(_without(EstimatorExample.checks, ESTIMATOR_FIRST), setting.made(SHORT), data)
        yield Stage(EstimatorInformationExample.checks, design, example)


def _controller_stages(setting: Setting) -> Iterator[Stage]:
    system = setting.linear
    design: Controller = setting.made(system.n_steps)
    with setting.separate_process() as separate_process:
        yield Stage((MADE,))
        yield Stage(CONTROLLER_FIRST[:1], design)
        example = ControllerInformationExample(
            system, design.preview, design.regulates, separate_process=separate_process
        )
        yield Stage(CONTROLLER_FIRST[1:], design, example.data)
        data = ControllerExample.random(system.model.nx, system.model.ny, design.preview, n_steps=SHORT)
        data = replace(data, pair=setting.limited_pair())
        yield Stage(_without(ControllerExample.checks, CONTROLLER_FIRST), setting.made(SHORT), data)
        yield Stage(ControllerInformationExample.checks, design, example)


@dataclass(frozen=True, eq=False)
class PlantInformationExample(InformationExample):
    """A plant in this process and in another one."""

    example: PlantExample

    @property
    def data(self) -> PlantExample:
        """Parameters, initial states, inputs and noises."""
        return self.example

    def simulated(self, component: Plant) -> Array:
        """States and outputs in this process."""
        return self.example.all(component).values


def _plant_stages(setting: Setting) -> Iterator[Stage]:
    design: Plant = setting.made(SHORT)
    with setting.separate_process(SHORT) as separate_process:
        yield Stage((MADE,))
        yield Stage(PLANT_FIRST[:1], design)
        example = PlantExample.random(design, n_steps=SHORT)
        yield Stage(_without(PlantExample.checks, PLANT_FIRST[:1]), design, example)
        yield Stage((FRESH,), design, PlantInformationExample(example, separate_process=separate_process))


def _simple_stages(example: Callable[[Setting], Any]) -> Callable[[Setting], Iterator[Stage]]:
    """Return the stages of a kind whose checks all have one example."""

    def stages(setting: Setting) -> Iterator[Stage]:
        design = setting.made(SHORT)
        yield Stage((MADE,))
        data = example(setting)
        yield Stage(data.checks, design, data)

    return stages


def _without(checks: tuple[Check, ...], others: tuple[Check, ...]) -> tuple[Check, ...]:
    return tuple(check for check in checks if check not in others)


STAGES: Mapping[str, Callable[[Setting], Iterator[Stage]]] = {
    "estimators": _estimator_stages,
    "controllers": _controller_stages,
    "plants": _plant_stages,
    "references": _simple_stages(lambda setting: ReferenceExample(setting.linear.model.ny)),
    "noises": _simple_stages(lambda setting: NoiseExample(NOISES)),
    "metrics": _simple_stages(lambda setting: MetricExample(example_record())),
    "figures": _simple_stages(lambda setting: FigureExample(example_results())),
}
CHECKS: Mapping[str, tuple[Check, ...]] = {
    "estimators": (MADE, *EstimatorExample.checks, *EstimatorInformationExample.checks),
    "controllers": (MADE, *ControllerExample.checks, *ControllerInformationExample.checks),
    "plants": (MADE, *PlantExample.checks, FRESH),
    "references": (MADE, *ReferenceExample.checks),
    "noises": (MADE, *NoiseExample.checks),
    "metrics": (MADE, *MetricExample.checks),
    "figures": (MADE, *FigureExample.checks),
}
"""Every check, by group of components."""


def stages(setting: Setting) -> Iterator[Stage]:
    """Return the checks of a component with what they are run on, in their order."""
    system = setting.system
    if isinstance(system, ExperimentSystem):
        design = setting.made(system.n_steps)
        with setting.separate_process() as separate_process:
            yield Stage((MADE,))
            example = ExperimentExample(system, design, separate_process=separate_process)
            yield Stage(ExperimentExample.checks, design, example)
        return
    if setting.group not in STAGES:
        raise NotApplicableError(f"there are no checks of {setting.group}")
    yield from STAGES[setting.group](setting)
