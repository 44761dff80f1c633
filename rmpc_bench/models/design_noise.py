"""Design models of any kind in one form: the matrices and noises of an uncertain linear system at one k.

Model   An `UncertainModel` is used as it is.  Any other model is written as a system without uncertainty,
        x(k+1) = A x + B u + f0 + w, y = C x + d0 + v: Bw = I, Dv = I, Bv = 0, Dw = 0, H = 0, G = 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.uncertain_linear import UncertainModel
from rmpc_bench.models.uncertain_system import SIZES, Matrices
from rmpc_bench.types import Array, Model


class DesignSystem(NamedTuple):
    """A design model at one k, written as an uncertain system with its noises."""

    nominal: LinearModel
    """The nominal model, with the constant parts f0 and d0."""
    m: Matrices
    W: Float[Array, "nw nw"]
    V: Float[Array, "nv nv"]
    S: Float[Array, "nw nv"]
    wbar: Float[Array, " nw"]
    """Mean of w; zero for a model without uncertainty, whose f0 and d0 contain the means."""
    vbar: Float[Array, " nv"]


def design_systems(model: Model, n_steps: int, scale: float = 1.0) -> list[DesignSystem]:
    """Return the design model at k = 0..N, one shared object as long as nothing varies.

    Parameters
    ----------
    model : an `UncertainModel`; any other model has no uncertainty
    n_steps : number of control periods N
    scale : factor of all uncertainty
    """
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
    m = Matrices(**{**zero, "A": now.A, "B": now.B, "C": now.C, "Bw": np.eye(nx), "Dv": np.eye(ny)})
    return DesignSystem(now, m, now.Q_w, now.R_v, now.S_wv, np.zeros(nx), np.zeros(ny))
