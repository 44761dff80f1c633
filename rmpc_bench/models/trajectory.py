"""Model of a nonlinear plant that is linearised again at every estimate.

Model   x(k+1) = F(x(k), u(k)) + w(k), y(k) = h(x(k)) + v(k), F the flow of the nominal plant over a sample.
        `around(k, x, u)` linearises at a state and an input of every run, as models/linearised.py does at an operating
        point: one exponential of [[A, B, f], [0, 0, 0]] per run.  An
        equation that depends on the time is linearised at the middle of the sample.
Cost    About 0.2 ms per run and linearisation for two states, as functions of the user are called for every run alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.dynamics import Dynamics, OfPlant, sampled, steps_of
from rmpc_bench.models.flow import PlantFlow
from rmpc_bench.models.noise_covariances import DesignNoise
from rmpc_bench.models.state_dependent import Affine, Pair, StateDependentModel
from rmpc_bench.types import Array


@dataclass(frozen=True, eq=False)
class TrajectoryModel(OfPlant, StateDependentModel):
    """A model that is linearised at the latest estimate.

    Parameters
    ----------
    dynamics : the nominal plant
    Ts : sampling time [s]
    substeps : given steps of the integration per sample; 0 for error control
    Q_w, R_v : covariances of the noises
    """

    dynamics: Dynamics
    Ts: float
    substeps: int
    Q_w: Float[Array, "nx nx"]
    R_v: Float[Array, "ny ny"]

    has_offsets = True

    @property
    def flow(self) -> PlantFlow:
        """The model without linearisation, as maps of many states at once."""
        return PlantFlow(self.dynamics, self.Ts, self.substeps, self.Q_w, self.R_v)

    def at_state(self, x: Float[Array, "runs nx"]) -> Pair:
        """Linearise at a state of every run, at the input nearest to 0."""
        low, high = self.dynamics.limits(self.dynamics.names.inputs)
        return Pair(*self.around(0, x, np.tile(np.clip(0.0, low, high), (len(x), 1)))[:2])

    def around(self, k: int, x: Float[Array, "runs nx"], u: Float[Array, "runs nu"]) -> Affine:
        """Linearise at a state and an input of every run; NaN where the plant is not defined."""
        t = (k + (0.5 if self.dynamics.continuous else 0.0)) * self.Ts
        made = [self._around(t, each, applied) for each, applied in zip(x, u, strict=True)]
        return Affine(*(np.array(parts) for parts in zip(*made, strict=True)))

    def _around(
        self, t: float, x: Float[Array, " nx"], u: Float[Array, " nu"]
    ) -> tuple[Array, Array, Array, Array, Array]:
        tangent, y = self.dynamics.slopes(x, u, t), self.dynamics.output(x)
        rest = self.dynamics.rest(x, u, t)
        if not all(np.isfinite(part).all() for part in (*tangent, y, rest)):
            n, m, q = len(x), len(u), len(y)
            shapes = ((n, n), (n, m), (n,), (q, n), (q,))
            return tuple(np.full(shape, np.nan) for shape in shapes)  # type: ignore[return-value]
        A, B, drift = sampled(self.dynamics, tangent, rest, self.Ts)
        return A, B, x + drift - A @ x - B @ u, tangent.C, y - tangent.C @ x

    def advance(self, k: int, x: Float[Array, "runs nx"], u: Float[Array, "runs nu"]) -> Float[Array, "runs nx"]:
        """Integrate every run over a sample; NaN where the plant is not defined."""
        return self.flow.advance(k, x, u)

    def measure(self, x: Float[Array, "runs nx"]) -> Float[Array, "runs ny"]:
        """Return the outputs of every run."""
        return np.array([self.dynamics.output(each) for each in x])


def relinearised(dynamics: Dynamics, Ts: float, noise: DesignNoise, substeps: int | None = None) -> TrajectoryModel:
    """Make a model that is linearised at every estimate."""
    Q_w, R_v = noise.covariances(len(dynamics.names.states), len(dynamics.names.outputs))
    return TrajectoryModel(dynamics, Ts, substeps or steps_of(dynamics), Q_w, R_v)
