"""Checks of plants: shapes, purity, and runs that do not depend on the block they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.outcome import (
    REPETITION,
    SEED,
    WORDS,
    Outcome,
    RunsExample,
    first_checks,
    require_valid_return_values,
)
from rmpc_bench.conformance.results import Check, copies, require, require_same, require_unchanged
from rmpc_bench.conformance.systems import Excitation, GivenEstimates, simulated
from rmpc_bench.simulation.reference import Constant
from rmpc_bench.simulation.scenario import Scenario, own_draws
from rmpc_bench.types import Array, Estimate, Method, Plant, PlantInfo, Status, as_motion


@dataclass(frozen=True, eq=False)
class PlantExample(RunsExample):
    """Parameters, initial states, inputs and noises that a plant is checked with."""

    parameters: Mapping[str, Float[Array, " runs"]]  # name -> (runs,) values, for every name in the plant's `nominal`
    x: Float[Array, "runs nx"]  # initial states of at least six runs
    u: Float[Array, "runs steps nu"]  # inputs of at least four steps
    w: Float[Array, "runs steps nw"]  # process noise
    v: Float[Array, "runs steps nv"]  # measurement noise
    noun: ClassVar[str] = "(x, y)"

    @classmethod
    def random(
        cls, plant: Plant, *, n_runs: int = 9, n_steps: int = 10, scale: float = 1.0, seed: int = 13
    ) -> PlantExample:
        """Draw parameters within 10 % of the nominal ones and normal states, inputs and noises.

        States and measurement noise have the standard deviation `scale`, inputs 20 times and process noise 0.1 times
        that.  States and inputs with limits are drawn between the quarters of their ranges.
        """
        rng = np.random.default_rng(seed)
        parameters = {name: value * rng.uniform(0.9, 1.1, n_runs) for name, value in plant.nominal.items()}
        shapes = ((n_runs, plant.nx), *((n_runs, n_steps, n) for n in (plant.nu, plant.nw, plant.nv)))
        x, u, w, v = (scale * rng.standard_normal(shape) for shape in shapes)
        limits = PlantInfo.of(plant).limits
        x, u = _within(limits.x, x, rng), _within(limits.u, 20.0 * u, rng)
        return cls(parameters, x, u, 0.1 * w, v)

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.x)

    def start(self, component: Plant, outcome: Outcome) -> Any:
        """Uncertain parameters of some runs."""
        parameters = {name: values[outcome.rows] for name, values in self.parameters.items()}
        rngs = [np.random.default_rng((99, row)) for row in outcome.rows]  # the same for a run in every block
        delta = component.draw(parameters, rngs, self.u.shape[1] - 1)
        return outcome.start.plant(component, delta, self.x[outcome.rows], outcome.shared)

    def noises(self, plant: Plant, delta: Any, rows: Sequence[int]) -> tuple[Array, Array]:
        """The noises that `step` and `output` receive."""
        w, v = self.w[rows], self.v[rows]
        return plant.mix(delta, w, v) if plant.mixes_noise else (w, v)

    def call(self, component: Plant, outcome: Outcome) -> None:
        """Simulate some runs; the numbers of a sample are x(k+1) and y(k), the returned values pairs of the two."""
        rows, delta = outcome.rows, self.start(component, outcome)
        w, v = self.noises(component, delta, rows)
        x = component.first_state(delta, self.x[rows])
        for k in outcome.samples(self.u.shape[1]):
            y = np.array(component.output(k, delta, x, v[:, k]))
            u = component.applied_inputs(self.u[rows, k])
            motion = as_motion(component.step(k, delta, x.copy(), u, w[:, k]))
            outcome.add_status(outcome.shared.failed)
            outcome.add_status(motion.status)
            x = np.array(motion.x)
            outcome.returned.append((motion._replace(x=x), y))
            outcome.numbers.append(np.concatenate([x, y], axis=1))


def _within(limits: tuple[Array, Array], values: Array, rng: np.random.Generator) -> Array:
    """Replace the components that have limits."""
    low, high = limits
    bounded = np.isfinite(low) & np.isfinite(high)
    if not bounded.any():
        return values
    low, high = (np.where(bounded, each, 0.0) for each in limits)
    return np.where(bounded, low + (high - low) * rng.uniform(0.25, 0.75, values.shape), values)


def _base_class(plant: Any, _: PlantExample) -> None:
    require(isinstance(plant, Plant), f"{type(plant).__name__} is not a subclass of Plant")
    require(plant.Ts > 0, f"the sampling time is {plant.Ts}")


def _shapes(plant: Plant, example: PlantExample) -> None:
    outcome, n_runs = example.all(plant), example.n_runs
    require_valid_return_values(outcome.journal, "shape")
    for k, (motion, y) in enumerate(outcome.returned):
        require(motion.x.shape == (n_runs, plant.nx), f"x has shape {motion.x.shape} at k = {k}; nx = {plant.nx}")
        require(y.shape == (n_runs, plant.ny), f"y has shape {y.shape} at k = {k}; ny = {plant.ny}")
        require(motion.x.dtype == y.dtype == np.float64, f"x is {motion.x.dtype}, y is {y.dtype}, not float64")
        require(motion.status.dtype == np.int8, f"status is {motion.status.dtype}, not int8")
        require(motion.status.shape == (n_runs,), f"status has shape {motion.status.shape} for {n_runs} runs")


def _finite(plant: Plant, example: PlantExample) -> str:
    outcome = example.all(plant)
    require_valid_return_values(outcome.journal, "finite")
    good = ~outcome.status.astype(bool)
    for k, numbers in enumerate(outcome.numbers):
        wrong = np.asarray(~np.isfinite(numbers[good]).all(axis=1))
        require(not wrong.any(), f"x or y of {wrong.sum()} of {len(good)} runs is not finite at k = {k}")
    words = sorted({WORDS[int(status)] for status in outcome.status[~good]})
    return f"{(~good).sum()} of {len(good)} runs end with {', '.join(words)}" if words else ""


def _arguments(plant: Plant, example: PlantExample) -> None:
    given = [*example.parameters.values(), example.x, example.u, example.w, example.v]
    before = copies(given)
    delta = example.begun(plant)
    w, v = example.noises(plant, delta, range(example.n_runs))
    received = [*delta, w, v]
    kept = copies(received)
    plant.step(0, delta, example.x, example.u[:, 0], w[:, 0])
    plant.output(0, delta, example.x, v[:, 0])
    require_unchanged(given, before)
    require_unchanged(received, kept)


def _purity(plant: Plant, example: PlantExample) -> None:
    delta = example.begun(plant)
    w, _ = example.noises(plant, delta, range(example.n_runs))
    first, second = (as_motion(plant.step(0, delta, example.x, example.u[:, 0], w[:, 0])) for _ in range(2))
    require_same("x(1)", second.x, first.x)
    require_same("status", second.status, first.status)


def _missing(plant: Plant, example: PlantExample) -> None:
    expected, run = example.all(plant), example.n_runs // 2
    for name in ("x", "u", "w", "v"):
        broken = getattr(example, name).copy()
        if not broken.size or (name == "x" and plant.has_own_start):
            continue
        place = (run, 0) if name == "x" else (run, 3)
        broken[place] = np.nan
        found = example.changed(**{name: broken}).evaluate(plant)
        others = (np.delete(each.values, run, axis=0) for each in (found, expected))
        require_same(f"(x, y) beside a missing {name}", *others)
        if name in ("x", "u"):
            states = found.values[run, :, : plant.nx]
            failed = bool(found.status[run]) or bool(np.isnan(states).any())
            require(failed, f"the state is finite although {name} is missing")


def _nominal(plant: Plant, example: PlantExample) -> None:
    wrong = [name for name, value in plant.nominal.items() if not np.isfinite(value)]
    require(not wrong, f"nominal values that are not finite: {', '.join(wrong)}")
    parameters = {name: np.array([value]) for name, value in plant.nominal.items()}
    w, v = np.zeros((1, 2, plant.nw)), np.zeros((1, 2, plant.nv))
    limits = PlantInfo.of(plant).limits
    # Without limits the origin; with limits their middle.
    x, u = (_middle(*each) for each in (limits.x, limits.u))
    nominal = PlantExample(parameters, x[None], np.tile(u, (1, 2, 1)), w, v)
    require_same("status", nominal.evaluate(plant).status, np.full(1, Status.OK, dtype=np.int8))


def _middle(low: Array, high: Array) -> Array:
    bounded = np.isfinite(low) & np.isfinite(high)
    low, high = (np.where(bounded, each, 0.0) for each in (low, high))
    return 0.5 * (low + high)


def no_estimate(nx: int) -> GivenEstimates:
    """Return an estimator whose estimate is always 0."""
    return GivenEstimates(
        lambda k, y: Estimate(np.zeros((len(y), nx)), None, None, np.zeros(len(y), dtype=np.int8), {})
    )


def _methods_apart(plant: Plant, example: PlantExample) -> None:
    """Simulate two equal methods with the same draws, one after the other."""
    u, (n_runs, n_steps) = example.u, example.u.shape[:2]
    scenario = Scenario(SEED, {}, {}, example.x[0], (), (), (), Constant(np.zeros(plant.ny)))
    draws = scenario.draw(plant, range(n_runs), n_steps)
    found: list[Any] = []
    for name in ("first", "second"):
        method = Method(name, no_estimate(plant.nx), Excitation(u))
        own = own_draws(scenario, plant, range(n_runs), n_steps, draws)
        found.append(simulated(plant, method, own, scenario.reference.sample(n_steps + 1), n_steps)[0].x)
    try:
        require_same("x of the second method", found[1], found[0])
    except AssertionError as error:
        text = (
            "the plant keeps something of the first method: keep it in the state or in what `draw` or `start` returns"
        )
        raise AssertionError(f"{error}; {text}") from None


FIRST = tuple(
    check._replace(run=_finite, says="every number of a run that has not failed is finite")
    if check.id == "finite"
    else check
    for check in first_checks(
        Check("base-class", "the plant is a subclass of Plant with a sampling time", _base_class, is_first=True),
        _shapes,
        "axis 0 is the run; states and outputs have the declared sizes; status is int8",
    )
)
PlantExample.checks = (
    *FIRST,
    Check("arguments", "step and output leave their arguments and the uncertain parameters unchanged", _arguments),
    Check("purity", "the same call twice gives the same bits", _purity),
    *REPETITION,
    Check("missing-number", "a missing state, input or noise of one run changes no other run", _missing),
    Check("nominal", "the nominal parameters are finite and admissible", _nominal),
    Check("methods-apart", "two equal methods of a block have the same trajectories, bit for bit", _methods_apart),
)
