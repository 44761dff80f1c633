"""State-dependent model with disturbances as further states.

Model   The matrices are those at the estimate of x; d enters by B(x) where it is at the input.  A model that is
        linearised along the trajectory is linearised at x and u + S d.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.disturbance import Entry, block_diagonal
from rmpc_bench.models.disturbed import Augmented
from rmpc_bench.models.state_dependent import Affine, Pair, StateDependentModel
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.types import Array


class DisturbedStates(Augmented, StateDependentModel):
    """A state-dependent model of [x; d]."""

    def __init__(self, undisturbed: StateDependentModel, entry: Entry, label: str = "") -> None:
        self.undisturbed, self.entry, self.label = undisturbed, entry, label

    @property
    def nx(self) -> int:
        """Number of states and disturbances."""
        return int(self.undisturbed.nx) + self.entry.nd

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return int(self.undisturbed.nu)

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return int(self.undisturbed.ny)

    @property
    def Q_w(self) -> Float[Array, "n n"]:
        """Covariance of the process noise and of the drift."""
        return block_diagonal(self.undisturbed.Q_w, self.entry.drift)

    @property
    def R_v(self) -> Float[Array, "ny ny"]:
        """Covariance of the measurement noise."""
        covariance: Array = self.undisturbed.R_v
        return covariance

    @property
    def has_offsets(self) -> bool:
        """Whether the model has constant parts and an output matrix that depend on the state."""
        return bool(self.undisturbed.has_offsets)

    @property
    def largest(self) -> Float[Array, " n"]:
        """Largest magnitude of every coordinate; the limit of a coordinate of x says nothing about d."""
        nx = self.undisturbed.nx
        return np.concatenate([np.full(nx, self.undisturbed.largest), np.full(self.entry.nd, np.inf)])

    @property
    def C(self) -> Float[Array, "ny n"]:
        """Output matrix."""
        return np.hstack([self.undisturbed.C, self.entry.C_d])

    @property
    def R_v_varies(self) -> bool:
        """Whether the measurement noise depends on k."""
        return bool(self.undisturbed.R_v_varies)

    def R_v_at(self, k: int) -> Float[Array, "ny ny"]:
        """Covariance of the measurement noise at k."""
        return self.undisturbed.R_v_at(k)  # type: ignore[no-any-return]

    def at_state(self, x: Float[Array, "runs n"]) -> Pair:
        """Sample the model with its matrices frozen at the state of every run."""
        return Pair(*self._pair(*self.undisturbed.at_state(self._parts(x)[0])))

    def around(self, k: int, x: Float[Array, "runs n"], u: Float[Array, "runs nu"]) -> Affine:
        """Linearise at the state, the disturbances and the input of every run."""
        x, d = self._parts(x)
        now = self.undisturbed.around(k, x, u + mv(self.entry.S, d))
        A, B = self._pair(now.A, now.B)
        runs, nd = d.shape
        C = np.concatenate([now.C, np.broadcast_to(self.entry.C_d, (runs, *self.entry.C_d.shape))], axis=2)
        return Affine(A, B, np.hstack([now.f, np.zeros((runs, nd))]), C, now.d)

    def advance(self, k: int, x: Float[Array, "runs n"], u: Float[Array, "runs nu"]) -> Float[Array, "runs n"]:
        """Return x(k+1) of the model without linearisation, and the same d."""
        x, d = self._parts(x)
        moved = self.undisturbed.advance(k, x, u + mv(self.entry.S, d)) + mv(self.entry.N, d)
        return np.hstack([moved, d])

    def measure(self, x: Float[Array, "runs n"]) -> Float[Array, "runs ny"]:
        """Return y of the model without linearisation."""
        x, d = self._parts(x)
        measured: Array = self.undisturbed.measure(x) + mv(self.entry.C_d, d)
        return measured

    def _parts(self, x: Float[Array, "runs n"]) -> tuple[Array, Array]:
        nx = self.undisturbed.nx
        return np.ascontiguousarray(x[:, :nx]), np.ascontiguousarray(x[:, nx:])

    def _pair(self, A: Float[Array, "runs nx nx"], B: Float[Array, "runs nx nu"]) -> tuple[Array, Array]:
        runs, nx, nu = B.shape
        full = np.zeros((runs, self.nx, self.nx))
        full[:, :nx, :nx], full[:, :nx, nx:] = A, self.entry.B_d(B)
        full[:, nx:, nx:] = np.eye(self.entry.nd)
        return full, np.concatenate([B, np.zeros((runs, self.entry.nd, nu))], axis=1)
