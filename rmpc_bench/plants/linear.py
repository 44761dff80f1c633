"""A linear system as the truth.

Model   x(k+1) = A_k x + B_k u + w,  y(k) = C_k x + v,  with the noises of the section `noise`.
Source  ma2025, (3), (4).
Cost    that of an uncertain linear system without its uncertainty.
"""

from __future__ import annotations

from rmpc_bench.models.uncertain_system import uncertain_system
from rmpc_bench.plants.uncertain_linear import UncertainLinear
from rmpc_bench.plants.uncertainty import Uncertainty
from rmpc_bench.types import SystemMatrix

NONE = Uncertainty("fixed", value=0.0)


def design(Ts: float, n_steps: int, *, A: SystemMatrix, B: SystemMatrix = None, C: SystemMatrix) -> UncertainLinear:
    """Linear system, every noise on its own state or output.

    A matrix that is not given is zero; a number is that number times the identity, a list the diagonal; entries may
    depend on the time index k.

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
        If sizes do not fit together, or an entry has no value at some k.
    """
    return UncertainLinear(uncertain_system(n_steps, {"A": A, "B": B, "C": C, "Bw": 1.0, "Dv": 1.0}), NONE, Ts)
