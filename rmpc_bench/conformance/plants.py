"""Checks of plants: shapes, purity, and runs that do not depend on the block they share."""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.results import FROZEN, Check, copies, require, require_same, require_unchanged
from rmpc_bench.types import Array, Plant, Status


@dataclass(frozen=True, eq=False)
class PlantExample:
    """Parameters, initial states, inputs and noises that a plant is checked with.

    Parameters
    ----------
    parameters : name -> (runs,) values, for every name in the plant's `nominal`
    x : (runs, nx) initial states of at least six runs
    u : (runs, steps, nu) inputs of at least four steps
    w : (runs, steps, nw) process noise
    v : (runs, steps, nv) measurement noise
    """

    parameters: Mapping[str, Float[Array, " runs"]]
    x: Float[Array, "runs nx"]
    u: Float[Array, "runs steps nu"]
    w: Float[Array, "runs steps nw"]
    v: Float[Array, "runs steps nv"]
    checks: ClassVar[tuple[Check, ...]]

    @classmethod
    def random(
        cls, plant: Plant, *, n_runs: int = 9, n_steps: int = 10, scale: float = 1.0, seed: int = 13
    ) -> PlantExample:
        """Draw parameters within 10 % of the nominal ones and normal states, inputs and noises.

        Parameters
        ----------
        plant : gives the sizes
        n_runs, n_steps : size of the example
        scale : standard deviation of states and measurement noise; inputs have 20 times, process noise 0.1 times it
        seed : of the generator
        """
        rng = np.random.default_rng(seed)
        parameters = {name: value * rng.uniform(0.9, 1.1, n_runs) for name, value in plant.nominal.items()}
        shapes = ((n_runs, plant.nx), *((n_runs, n_steps, n) for n in (plant.nu, plant.nw, plant.nv)))
        x, u, w, v = (scale * rng.standard_normal(shape) for shape in shapes)
        return cls(parameters, x, 20.0 * u, 0.1 * w, v)

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.x)

    def drawn(self, plant: Plant, rows: Sequence[int]) -> tuple[Any, Array, Array]:
        """Uncertain parameters of some runs, and the noises that `step` and `output` receive."""
        parameters = {name: values[rows] for name, values in self.parameters.items()}
        rngs = [np.random.default_rng((99, int(row))) for row in rows]  # the same for a run in every block
        delta = plant.draw(parameters, rngs, self.u.shape[1] - 1)
        w, v = self.w[rows], self.v[rows]
        return (delta, *plant.mix(delta, w, v)) if plant.mixes_noise else (delta, w, v)

    def simulated(self, plant: Plant, rows: Sequence[int] | None = None) -> tuple[Array, Array, Array]:
        """States, outputs and last statuses of some runs: (rows, steps, nx), (rows, steps, ny), (rows,)."""
        rows = range(self.n_runs) if rows is None else rows
        rows = list(rows)
        delta, w, v = self.drawn(plant, rows)
        x, states, outputs = self.x[rows], [], []
        for k in range(self.u.shape[1]):
            outputs.append(plant.output(k, delta, x, v[:, k]))
            x, status = plant.step(k, delta, x, self.u[rows, k], w[:, k])
            states.append(x)
        return np.stack(states, axis=1), np.stack(outputs, axis=1), status


def _require_same(found: Sequence[Array], expected: Sequence[Array]) -> None:
    for name, left, right in zip(("x", "y", "status"), found, expected, strict=True):
        require_same(name, left, right)


def _base_class(plant: Any, _: PlantExample) -> None:
    require(isinstance(plant, Plant), f"{type(plant).__name__} is not a subclass of Plant")
    require(plant.Ts > 0, f"the sampling time is {plant.Ts}")


def _shapes(plant: Plant, example: PlantExample) -> None:
    x, y, status = example.simulated(plant)
    n_runs, n_steps = example.u.shape[:2]
    require(x.shape == (n_runs, n_steps, plant.nx), f"x has shape {x.shape[:1] + x.shape[2:]}")
    require(y.shape == (n_runs, n_steps, plant.ny), f"y has shape {y.shape[:1] + y.shape[2:]}")
    require(x.dtype == y.dtype == np.float64, f"x is {x.dtype}, y is {y.dtype}, not float64")
    require(status.dtype == np.int8, f"status is {status.dtype}, not int8")
    require_same("status", status, np.full(n_runs, Status.OK, dtype=np.int8))


def _arguments(plant: Plant, example: PlantExample) -> None:
    given = [*example.parameters.values(), example.x, example.u, example.w, example.v]
    before = copies(given)
    delta, w, v = example.drawn(plant, range(example.n_runs))
    received = [*delta, w, v]
    kept = copies(received)
    plant.step(0, delta, example.x, example.u[:, 0], w[:, 0])
    plant.output(0, delta, example.x, v[:, 0])
    require_unchanged(given, before)
    require_unchanged(received, kept)


def _purity(plant: Plant, example: PlantExample) -> None:
    delta, w, _ = example.drawn(plant, range(example.n_runs))
    first, second = (plant.step(0, delta, example.x, example.u[:, 0], w[:, 0]) for _ in range(2))
    require_same("x(1)", second.x, first.x)
    require_same("status", second.status, first.status)
    _require_same(example.simulated(plant), example.simulated(plant))


def _alone(plant: Plant, example: PlantExample) -> None:
    together = example.simulated(plant)
    for run in range(example.n_runs):
        _require_same(example.simulated(plant, [run]), [part[run : run + 1] for part in together])


def _order(plant: Plant, example: PlantExample) -> None:
    order = np.random.default_rng(5).permutation(example.n_runs).tolist()
    _require_same(example.simulated(plant, order), [part[order] for part in example.simulated(plant)])


def _pickle(plant: Plant, example: PlantExample) -> None:
    _require_same(example.simulated(pickle.loads(pickle.dumps(plant))), example.simulated(plant))


def _missing(plant: Plant, example: PlantExample) -> None:
    expected, run = example.simulated(plant), example.n_runs // 2
    for name in ("x", "u", "w", "v"):
        broken = getattr(example, name).copy()
        if not broken.size:
            continue
        place = (run, 0) if name == "x" else (run, 3)
        broken[place] = np.nan
        found = replace(example, **{name: broken}).simulated(plant)
        others = [[np.delete(part, run, axis=0) for part in parts] for parts in (found, expected)]
        _require_same(*others)
        if name in ("x", "u"):
            require(bool(np.isnan(found[0][run]).any()), f"the state hides a missing {name}")


def _nominal(plant: Plant, _: PlantExample) -> None:
    wrong = [name for name, value in plant.nominal.items() if not np.isfinite(value)]
    require(not wrong, f"nominal values that are not finite: {', '.join(wrong)}")
    parameters = {name: np.array([value]) for name, value in plant.nominal.items()}
    x, u, w, v = (np.zeros(shape) for shape in ((1, plant.nx), (1, 2, plant.nu), (1, 2, plant.nw), (1, 2, plant.nv)))
    status = PlantExample(parameters, x, u, w, v).simulated(plant)[-1]
    require_same("status", status, np.full(1, Status.OK, dtype=np.int8))


PlantExample.checks = (
    Check("base-class", "the plant is a subclass of Plant with a positive sampling time", _base_class, is_first=True),
    FROZEN,
    Check("shapes", "axis 0 is the run; states and outputs have the declared sizes; status is int8", _shapes),
    Check("arguments", "step and output leave their arguments and the uncertain parameters unchanged", _arguments),
    Check("purity", "the plant has no memory: the same call twice gives the same bits", _purity),
    Check("batch-independence", "a run gives the same bits alone and inside any block", _alone),
    Check("order", "permuting the runs permutes the trajectories, bit for bit", _order),
    Check("pickle", "a copy made by pickle gives the same bits", _pickle, "information"),
    Check("missing-number", "a missing state, input or noise of one run changes no other run", _missing),
    Check("nominal", "the nominal parameters are finite and admissible", _nominal),
)
