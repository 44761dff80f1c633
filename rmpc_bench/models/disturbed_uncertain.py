"""Uncertain linear model with disturbances as further states.

Model   [x; d] with the uncertainty of x: d is certain, so that rows of H and columns of G are zero.  The drift is a
        further process noise: w becomes [w; xi].
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.disturbance import Entry, block_diagonal
from rmpc_bench.models.disturbed import Augmented
from rmpc_bench.models.uncertain_linear import UncertainModel
from rmpc_bench.models.uncertain_system import Matrices, UncertainSystem
from rmpc_bench.types import Array


class DisturbedUncertain(Augmented, UncertainModel):
    """An uncertain linear model of [x; d]: the drift is a further process noise, and d has no uncertainty."""

    def __init__(self, undisturbed: UncertainModel, entry: Entry, label: str = "") -> None:
        nd = entry.nd
        own = {
            "undisturbed": undisturbed,
            "entry": entry,
            "label": label,
            "system": augmented_system(undisturbed.system, entry),
            "W": block_diagonal(undisturbed.W, entry.drift),
            "V": undisturbed.V,
            "S": np.vstack([undisturbed.S, np.zeros((nd, len(undisturbed.V)))]),
            "wbar": entry.padded(undisturbed.wbar),
            "vbar": undisturbed.vbar,
        }
        for name, value in own.items():
            object.__setattr__(self, name, value)


def augmented_system(system: UncertainSystem, entry: Entry) -> UncertainSystem:
    """Return the uncertain system of [x; d] with the noise [w; xi].

    Parameters
    ----------
    system : of a model, or of the plant for an oracle estimator
    entry : how d enters it
    """
    m, nd = system.over_time, entry.nd
    A, B_d = _same_times(m.A, entry.B_d(m.B))
    below = np.zeros((len(A), nd, A.shape[2]))
    kept = np.broadcast_to(np.eye(nd), (len(A), nd, nd))
    C, C_d = m.C, np.broadcast_to(entry.C_d, (len(m.C), *entry.C_d.shape))
    changed = {
        "A": np.concatenate([np.concatenate([A, B_d], axis=2), np.concatenate([below, kept], axis=2)], axis=1),
        "C": np.concatenate([C, C_d], axis=2),
        "Bw": _blocks(m.Bw, nd),
        "Dw": _padded(m.Dw, 2, nd),
        "G_x": _padded(m.G_x, 2, nd),
        "G_w": _padded(m.G_w, 2, nd),
        **{name: _padded(getattr(m, name), 1, nd) for name in ("B", "Bv", "H_A", "H_Bw", "H_Bv")},
    }
    return UncertainSystem(Matrices(**{**m._asdict(), **changed}))


def _same_times(A: Array, B: Array) -> tuple[Array, Array]:
    """Return two series over k with the same number of entries."""
    n = max(len(A), len(B))
    return tuple(np.broadcast_to(each, (n, *each.shape[1:])) for each in (A, B))  # type: ignore[return-value]


def _padded(M: Float[Array, "k rows columns"], axis: int, n: int) -> Array:
    """Return matrices with n further rows (axis 1) or columns (axis 2) of zeros."""
    return np.pad(M, [(0, n if each == axis else 0) for each in range(3)])


def _blocks(Bw: Float[Array, "k nx nw"], nd: int) -> Array:
    """Return [Bw 0; 0 I] for every k."""
    full = np.pad(Bw, ((0, 0), (0, nd), (0, nd)))
    full[:, Bw.shape[1] :, Bw.shape[2] :] = np.eye(nd)
    return full
