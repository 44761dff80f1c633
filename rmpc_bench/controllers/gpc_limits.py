"""Limits of generalised predictive control: their keys, clipping, and what is applied where a program is not solved.

Shared  By the laws of gpc_law.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int8

from rmpc_bench.controllers.constrained import with_fallback
from rmpc_bench.controllers.gpc_programs import ConstantProgram, VaryingProgram
from rmpc_bench.controllers.gpc_rows import HardRows, LimitedHorizon
from rmpc_bench.controllers.limits import Bounds, Fallback, Limits, SoftLimit, bounds_of, refuse_unused
from rmpc_bench.controllers.prediction import Frozen
from rmpc_bench.types import Array, Command, PlantInfo


@dataclass(frozen=True, eq=False)
class InputLimits:
    """Limits of the inputs and what is applied where a program is not solved.

    Parameters
    ----------
    u, du : bounds of u - u_op and of its increment
    fallback : as in `Limits`
    """

    u: Bounds
    du: Bounds
    fallback: Fallback | None

    def clipped(self, u: Float[Array, "runs nu"], u_previous: Float[Array, "runs nu"]) -> Float[Array, "runs nu"]:
        """Return inputs with the increment clipped first, then the input; inputs within the limits keep their bits."""
        if np.isfinite(self.du).any():
            u = np.clip(u, u_previous + self.du.low, u_previous + self.du.high)
        return np.clip(u, *self.u)

    def command(
        self,
        u: Float[Array, "runs nu"],
        free: Float[Array, "runs nu"],
        steps: Int8[Array, " runs"] | None,
        u_previous: Float[Array, "runs nu"],
    ) -> Command:
        """Return the command; the solver satisfies the limits to its tolerance only, clipping to the last bit."""
        clipped = self.clipped(free, u_previous)
        if steps is None:
            return Command(clipped)
        return with_fallback(self.clipped(u, u_previous), clipped, u_previous, steps, self.fallback)


@dataclass(frozen=True, eq=False)
class GpcLimits:
    """Limits of a law; create them with `limits_of`."""

    inputs: InputLimits  # limits of the inputs
    horizon: LimitedHorizon | None = None  # rows of every sample; None where the limits clip
    # of a constant model with constant weights, or of any other one; None where the limits clip
    program: ConstantProgram | VaryingProgram | None = None

    @property
    def optimised(self) -> bool:
        """Whether the limits are constraints of the optimisation."""
        return self.program is not None

    def constant(
        self,
        free: Float[Array, "runs nu"],
        x: Float[Array, "runs nx"],
        u_previous: Float[Array, "runs nu"],
        w: Float[Array, "N ny"],
    ) -> Command:
        """Return the command of a constant law, with the inputs as deviations from the operating point."""
        if self.program is None:
            return self.inputs.command(free, free, None, u_previous)
        assert isinstance(self.program, ConstantProgram)
        u, steps = self.program.inputs(free, x, u_previous, w)
        return self.inputs.command(u, free, steps, u_previous)

    def varying(
        self,
        k: int,
        now: Frozen,
        Q_yw: Float[Array, "weights ny ny"],
        x: Float[Array, "runs nx"],
        u_previous: Float[Array, "runs nu"],
        w: Float[Array, "N ny"],
    ) -> tuple[Command, Float[Array, " runs"]]:
        """Return the command of any other law and the minimal costs without limits."""
        assert self.horizon is not None and isinstance(self.program, VaryingProgram)
        path, u, steps = self.program.inputs(now, Q_yw, self.horizon.at(k), x, u_previous, w)
        return self.inputs.command(u, path.U[:, 0], steps, u_previous), path.loss


def limits_of(
    limits: Limits | None, soft: dict[str, SoftLimit] | None, model: Any, nx: int, N: int, plant_info: PlantInfo | None
) -> GpcLimits | None:
    """Return the limits without a program, None without limits."""
    if limits is None and not soft:
        return None
    limits = limits or Limits()
    refuse_unused(limits, soft)
    u = bounds_of(limits.u, model.nu, "limits.u")
    # The inputs of the laws are deviations from the operating point.
    u, du = Bounds(u.low - model.u_op, u.high - model.u_op), bounds_of(limits.du, model.nu, "limits.du")
    inputs = InputLimits(u, du, limits.fallback)
    if limits.enforce == "clip":
        return GpcLimits(inputs)
    horizon = LimitedHorizon(model, nx, HardRows.of(u, du, N), soft or {}, N, plant_info)
    # Wrong names and sizes are reported now.
    horizon.at(0)
    return GpcLimits(inputs, horizon)
