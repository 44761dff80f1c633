"""Linear plant.

Model   x(k+1) = A_k x + B_k u + w,  y(k) = C_k x + v.  The section `noise` defines w and v.
Source  ma2025, (3), (4).
Cost    As `uncertain-linear` without uncertainty.
"""

from __future__ import annotations

from rmpc_bench.models.uncertain_system import uncertain_system
from rmpc_bench.plants.uncertain_linear import UncertainLinear
from rmpc_bench.plants.uncertainty import Uncertainty
from rmpc_bench.types import SystemMatrix

NONE = Uncertainty("fixed", value=0.0)


def design(Ts: float, n_steps: int, *, A: SystemMatrix, B: SystemMatrix = None, C: SystemMatrix) -> UncertainLinear:
    """Linear system with one noise per state and one per output.

    A missing matrix is zero.  A number stands for that number times the identity.  A is a list of rows or a list, its
    diagonal; the other matrices are lists of rows.  Entries may depend on the time index k.

    Parameters
    ----------
    Ts : sampling time [s]
    n_steps : number of control periods N
    A : (nx, nx) state matrix
    B : (nx, nu) input matrix
    C : (ny, nx) output matrix

    Raises
    ------
    DesignError
        If the sizes are inconsistent, or an entry is undefined at some k.
    """
    return UncertainLinear(uncertain_system(n_steps, {"A": A, "B": B, "C": C, "Bw": 1.0, "Dv": 1.0}), NONE, Ts)
