"""The nominal plant without noise, sample by sample and for one run, as other programs take it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.uncertain_system import UncertainSystem
from rmpc_bench.plants.linear import ParametricLinear
from rmpc_bench.types import Array, DesignError, LinearPlant, Plant, Status

POINTS, SIZES = 4, (0.1, 1.0, 10.0)
"""Points of each size at which a linear part is compared with the plant."""
EQUAL = 1e-12
"""Relative difference up to which both are equal."""


@dataclass(frozen=True, eq=False)
class NominalStep:
    """The functions x(k+1) and y(k) of a plant at its nominal parameters; create it with `of`."""

    plant: Plant
    linear: LinearPlant | None  # its matrices; None for a plant that is not linear or varies with k

    @classmethod
    def of(cls, plant: Plant) -> NominalStep:
        """Return the functions of a plant; refuse one with a memory besides its state, or of recorded runs."""
        if plant.recorded is not None or (plant.starts_runs and not isinstance(plant, ParametricLinear)):
            raise DesignError("a plant with recorded runs, or with a memory besides its state, is no system of states")
        system: UncertainSystem | None = plant.system
        if system is not None:
            now = system.at(0)
            return cls(plant, None if system.varies else LinearPlant(now.A, now.B, now.C, np.eye(plant.nx), now.D))
        step, linear = cls(plant, None), plant.linear(dict(plant.nominal))
        return step if linear is None or plant.limits_inputs or not step._equals(linear) else cls(plant, linear)

    def advance(self, k: int, x: Array, u: Array, parameters: Mapping[str, float]) -> Float[Array, " nx"]:
        """Return x(k+1); NaN where the plant is not defined."""
        if self.plant.system is not None:
            now = self.plant.system.at(k)
            return np.asarray(now.A @ x + now.B @ u)
        delta, w = self._delta(parameters), np.zeros((1, self.plant.nw))
        motion = self.plant.step(k, delta, _row(x), self.plant.applied_inputs(_row(u)), w)
        return motion.x[0] if motion.status[0] == Status.OK else np.full(self.plant.nx, np.nan)

    def output(self, k: int, x: Array, u: Array, parameters: Mapping[str, float]) -> Float[Array, " ny"]:
        """Return y(k) without noise."""
        if self.plant.system is not None:
            now = self.plant.system.at(k)
            return np.asarray(now.C @ x + now.D @ u)
        acting = [self.plant.applied_inputs(_row(u))] if self.plant.feedthrough else []
        y = self.plant.output(k, self._delta(parameters), _row(x), np.zeros((1, self.plant.nv)), *acting)
        return np.asarray(y[0])

    def _delta(self, parameters: Mapping[str, float]) -> Any:
        values = {**self.plant.nominal, **parameters}
        columns = {name: np.array([float(values[name])]) for name in self.plant.nominal}
        return self.plant.draw(columns, [np.random.Generator(np.random.PCG64(0))], 1)

    def _equals(self, linear: LinearPlant) -> bool:
        """Whether the plant is its linear part: a plant with friction, for example, is not."""
        rng, (A, B, C, _, D) = np.random.Generator(np.random.PCG64(7)), linear
        if A.shape[0] != self.plant.nx:
            return False
        for size in SIZES:
            for _ in range(POINTS):
                x, u = size * rng.standard_normal(self.plant.nx), size * rng.standard_normal(self.plant.nu)
                pairs = (
                    (self.advance(0, x, u, {}), A @ x + B @ u),
                    (self.output(0, x, u, {}), C @ x + np.broadcast_to(D, (len(C), len(u))) @ u),
                )
                if not all(np.allclose(a, b, rtol=EQUAL, atol=EQUAL * size) for a, b in pairs):
                    return False
        return True


def _row(values: Array) -> Float[Array, "1 n"]:
    return np.array(values, dtype=float)[None]
