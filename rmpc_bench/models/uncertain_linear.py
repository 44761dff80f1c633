"""Uncertain linear design model: nominal matrices, bounds of the uncertainty, noises.

Model   The system of uncertain_system.py with white noises: w has mean wbar and covariance W, v has mean vbar and
        covariance V, and the cross-covariance is E (w - wbar)(v - vbar)' = S.
        Methods without uncertainty use the nominal model x(k+1) = A x + B u + f0 + w~, y = C x + d0 + v~, with
        f0 = Bw wbar + Bv vbar, d0 = Dw wbar + Dv vbar and the covariances of w~ = Bw w + Bv v and v~ = Dw w + Dv v.
Source  souto2011, (8), (9), (20), (21).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import SAME_SCALE, NoiseScale
from rmpc_bench.models.uncertain_system import (
    SIZES,
    Matrices,
    OfSystem,
    UncertainSystem,
    takes_matrices,
    uncertain_system,
)
from rmpc_bench.numerics.linalg import as_covariance, as_vector, is_possible, symmetrise
from rmpc_bench.types import Array, DesignError, Matrix, Model, SystemMatrix, does_not_fit

EQUATION = r"""x_{k+1} = (A + H_A F_x G_x) x_k + B u_k + (B_w + H_{Bw} F_w G_w) w_k + (B_v + H_{Bv} F_v G_v) v_k, \quad
y_k = (C + H_C F_x G_x) x_k + D u_k + (D_w + H_{Dw} F_w G_w) w_k + (D_v + H_{Dv} F_v G_v) v_k"""


@dataclass(frozen=True, eq=False)
class UncertainModel(OfSystem, Model):
    """An uncertain linear system with the means and covariances of its noises."""

    system: UncertainSystem
    W: Float[Array, "nw nw"]
    V: Float[Array, "nv nv"]
    S: Float[Array, "nw nv"]
    wbar: Float[Array, " nw"]
    vbar: Float[Array, " nv"]

    varies = property(lambda self: self.system.varies)
    feedthrough = property(lambda self: "D" in self.system.active)
    w_law = property(lambda self: (self.wbar, self.W))
    v_law = property(lambda self: (self.vbar, self.V))

    @property
    def noise(self) -> tuple[Float[Array, " nn"], Float[Array, "nn nn"]]:
        """Mean and covariance of [w; v]."""
        joint = np.block([[self.W, self.S], [self.S.T, self.V]])
        return np.concatenate([self.wbar, self.vbar]), joint

    def at(self, k: int) -> LinearModel:
        """Return the nominal model at k."""
        return self._nominal_at(self.system.at(k)) if self.varies else self._always

    @cached_property
    def _always(self) -> LinearModel:
        return self._nominal_at(self.system.at(0))

    def _nominal_at(self, m: Matrices) -> LinearModel:
        mean, joint = self.noise
        B, D = np.hstack([m.Bw, m.Bv]), np.hstack([m.Dw, m.Dv])
        Q_w, R_v = symmetrise(B @ joint @ B.T), symmetrise(D @ joint @ D.T)
        return LinearModel(m.A, m.B, m.C, Q_w, R_v, S_wv=B @ joint @ D.T, f0=B @ mean, d0=D @ mean, D=m.D)


@takes_matrices
def design(
    n_steps: int,
    *,
    W: Matrix = 0.0,
    V: Matrix = 0.0,
    S: float | list[list[float]] = 0.0,
    wbar: float | list[float] = 0.0,
    vbar: float | list[float] = 0.0,
    scale: NoiseScale | None = None,
    **matrices: SystemMatrix,
) -> UncertainModel:
    """Uncertain linear model; `from: plant` uses the plant's matrices where none are given.

    A missing matrix is zero.  A list is a diagonal for A, W and V only.  Entries may depend on k.

    Parameters
    ----------
    n_steps : number of control periods N
    matrices : the matrices of the system
    W : (nw, nw) covariance of w
    V : (nv, nv) covariance of v
    S : (nw, nv) cross-covariance of w and v
    wbar : (nw,) mean of w
    vbar : (nv,) mean of v
    scale : factors on the standard deviations of w (`process`) and v (`measurement`), such as {measurement: 0.1}

    Raises
    ------
    DesignError
        If the sizes are inconsistent, or W, V and S do not form a joint covariance.
    """
    system = uncertain_system(n_steps, matrices)
    nw, nv = system.size("nw"), system.size("nv")
    cov_w, cov_v = as_covariance(W, nw, "W"), as_covariance(V, nv, "V")
    mean_w, mean_v = as_vector(wbar, nw, "wbar"), as_vector(vbar, nv, "vbar")
    cross, factor = _cross(S, cov_w, cov_v), scale or SAME_SCALE
    cov_w, cov_v = factor.process**2 * cov_w, factor.measurement**2 * cov_v
    return UncertainModel(system, cov_w, cov_v, factor.process * factor.measurement * cross, mean_w, mean_v)


def _cross(S: float | list[list[float]], W: Array, V: Array) -> Float[Array, "nw nv"]:
    """Expand a cross-covariance and check that the joint covariance is positive semidefinite."""
    shape = (len(W), len(V))
    try:
        given = np.array(S, dtype=float)
    except ValueError:
        raise DesignError("must be a list of rows of the same length", "S") from None
    cross = np.zeros(shape) if given.ndim == 0 and not given.any() else np.atleast_2d(given)
    if cross.shape != shape:
        raise DesignError(does_not_fit(cross.shape, shape), "S")
    if not is_possible(cross, W, V):
        raise DesignError("the joint covariance [W S; S' V] is not positive semidefinite", "S")
    return cross


# Design models of any kind in one form: the matrices and noises of an uncertain linear system at one k.
#
# Model   An `UncertainModel` is used as it is.  Any other model is written as a system without uncertainty,
#         x(k+1) = A x + B u + f0 + w, y = C x + d0 + v: Bw = I, Dv = I, Bv = 0, Dw = 0, H = 0, G = 0.


class DesignSystem(NamedTuple):
    """A design model at one k, written as an uncertain system with its noises."""

    nominal: LinearModel  # the nominal model, with the constant parts f0 and d0
    m: Matrices
    W: Float[Array, "nw nw"]
    V: Float[Array, "nv nv"]
    S: Float[Array, "nw nv"]
    wbar: Float[Array, " nw"]  # mean of w; zero for a model without uncertainty, whose f0 and d0 contain the means
    vbar: Float[Array, " nv"]


def design_systems(model: Model, n_steps: int, scale: float = 1.0) -> list[DesignSystem]:
    """Return the design model at k = 0..N, one shared object as long as nothing varies."""
    found: list[DesignSystem] = []
    if isinstance(model, UncertainModel):
        system = model.system.scaled(scale)
        noises = (model.W, model.V, model.S, model.wbar, model.vbar)
        for k in range(n_steps + 1 if system.varies else 1):
            found.append(DesignSystem(model.at(k), system.at(k), *noises))
        return found if system.varies else found * (n_steps + 1)
    for k in range(n_steps + 1):
        now = model.at(k)
        found.append(found[-1] if found and found[-1].nominal is now else _without_uncertainty(now))
    return found


def _without_uncertainty(now: LinearModel) -> DesignSystem:
    nx, ny = now.nx, now.ny
    sizes = {name: 1 for pair in SIZES.values() for name in pair} | {"nx": nx, "nu": now.nu, "ny": ny}
    sizes |= {"nw": nx, "nv": ny}
    zero = {name: np.zeros((sizes[rows], sizes[columns])) for name, (rows, columns) in SIZES.items()}
    m = Matrices(**{**zero, "A": now.A, "B": now.B, "C": now.C, "D": now.D, "Bw": np.eye(nx), "Dv": np.eye(ny)})
    return DesignSystem(now, m, now.Q_w, now.R_v, now.S_wv, np.zeros(nx), np.zeros(ny))
