"""Linear plant.

Model   x(k+1) = A_k x + B_k u + w,  y(k) = C_k x + D_k u + v.  The section `noise` defines w and v.
Source  ma2025, (3), (4).
Cost    As `uncertain-linear` without uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.library_systems import ParametricSystem, SampledSystem
from rmpc_bench.models.uncertain_system import uncertain_system
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.plants.ode_design import bounds_by_name
from rmpc_bench.plants.uncertain_linear import UncertainLinear, Uncertainty
from rmpc_bench.types import (
    Array,
    LinearPlant,
    Motion,
    Plant,
    RunFailure,
    RunInfo,
    Signals,
    Status,
    Statuses,
    SystemMatrix,
)
from rmpc_bench.types.plant import Generators, Inputs, Noises, Outputs, ParameterValues, States

EQUATION = r"x_{k+1} = A_k x_k + B_k u_k + w_k, \quad y_k = C_k x_k + D_k u_k + v_k"
OK = np.int8(Status.OK)
NOT_UNCERTAIN = Uncertainty("fixed", value=0.0)


# Linear plant whose matrices may depend on the parameters of a run.
#
# Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + D u(k) + v(k) with the matrices of the parameters of the
#         run.  A continuous system is sampled exactly, with the input held over a sample.
# Names   States, inputs and outputs have the names that the system gives them.  The simulation limits inputs to their
#         bounds before they act.
# Cost    Matrices: one exponential per run with parameters of its own.  A step is three small products per run.
# Fails   Status `out-of-range`: a parameter is not finite.  Status `crashed`: the system cannot be made from the
#         parameters of the run, or has other sizes than the nominal one.


class Matrices(NamedTuple):
    """Matrices of every run."""

    A: Float[Array, "runs nx nx"]
    B: Float[Array, "runs nx nu"]
    C: Float[Array, "runs ny nx"]
    D: Float[Array, "runs ny nu"]
    numbers: Float[Array, "runs n_parameters"]  # parameters, in the order of their names
    status: Statuses


@dataclass(frozen=True, eq=False)
class FixedLinear(UncertainLinear):
    """A linear plant without uncertainty whose signals have names."""

    signals: Signals = field(default_factory=lambda: Signals((), (), ()))
    A_c: Float[Array, "nx nx"] | None = None


@dataclass(frozen=True, eq=False)
class ParametricLinear(Plant):
    """A linear plant with matrices of its own for every run; build it with `linear_plant`."""

    Ts: float
    family: ParametricSystem
    signals: Signals
    feedthrough: bool = False
    starts_runs = True

    @property
    def nominal(self) -> Mapping[str, float]:
        """Parameters with their nominal values."""
        return self.family.nominal

    @property
    def A_c(self) -> Float[Array, "nx nx"] | None:
        """A of x' at the nominal parameters."""
        return self.family.A_c

    def draw(self, parameters: ParameterValues, rngs: Generators, n_steps: int) -> Matrices:
        """Return the matrices of every run; a run that has none gets the nominal ones and a status."""
        columns = [parameters[name] for name in self.nominal]
        numbers = np.stack(columns, axis=1).astype(float) if columns else np.zeros((len(rngs), 0))
        # Runs with the same parameters have the same matrices.
        distinct, row_of = np.unique(numbers, axis=0, return_inverse=True)
        made = [self._of(values) for values in distinct]
        statuses = np.array([OK if isinstance(each, SampledSystem) else each[0] for each in made], dtype=np.int8)
        if (statuses != OK).any():
            usual = self.family.sampled(self.nominal, self.Ts)
            made = [each if isinstance(each, SampledSystem) else usual for each in made]
        row_of = row_of.reshape(len(numbers))
        A, B, C, D = (np.array([each[i] for each in made])[row_of] for i in range(4))
        return Matrices(A, B, C, D, numbers, statuses[row_of])

    def start(self, delta: Matrices, x0: States, runs: RunInfo) -> Matrices:
        """Note why some of the runs have no matrices."""
        for i in np.flatnonzero(delta.status != OK).tolist():
            found = self._of(delta.numbers[i])
            if runs.alive[i] and not isinstance(found, SampledSystem):
                values: dict[str, Any] = {"p": dict(zip(self.nominal, delta.numbers[i].tolist(), strict=True))}
                runs.journal.fail(RunFailure(runs.index[i], int(found[0]), "plant", 0, found[1], "", values))
        return delta

    def step(self, k: int, delta: Matrices, x: States, u: Inputs, w: Noises) -> Motion:
        """Return x(k+1)."""
        return Motion(mv(delta.A, x) + mv(delta.B, u) + w, delta.status.copy())

    def output(self, k: int, delta: Matrices, x: States, v: Noises, *u: Array) -> Outputs:
        """Measure."""
        y = mv(delta.C, x)
        return (y + mv(delta.D, *u) if self.feedthrough else y) + v

    def linear(self, parameters: Mapping[str, float]) -> LinearPlant | None:
        """Return the matrices for some parameters; None where there are none."""
        found = self._of(np.array([parameters[name] for name in self.nominal]))
        return LinearPlant(*found[:3], np.eye(self.nx), found.D) if isinstance(found, SampledSystem) else None

    def _of(self, numbers: Float[Array, " n_parameters"]) -> SampledSystem | tuple[Status, str]:
        """Sample the system of some parameters; a status and the reason where it cannot be made."""
        if not np.isfinite(numbers).all():
            return Status.OUT_OF_RANGE, "a parameter is not a finite number"
        try:
            made = self.family.sampled(dict(zip(self.nominal, numbers.tolist(), strict=True)), self.Ts)
        # The function that makes the system is the user's: it may raise anything.
        except Exception as error:
            return Status.CRASHED, f"{self.family.key}: {type(error).__name__}: {error}"
        sizes, wanted = (len(made.A), made.B.shape[1], len(made.C)), (self.nx, self.nu, self.ny)
        if sizes != wanted:
            what = f"has {sizes[0]} states, {sizes[1]} inputs, {sizes[2]} outputs; the nominal system has {wanted}"
            return Status.CRASHED, f"{self.family.key}: {what}"
        return made


def linear_plant(
    system: ParametricSystem, Ts: float, n_steps: int, bounds: Mapping[str, tuple[float, float]] | None
) -> Plant:
    """Return a linear system as a plant.

    A system without parameters and without bounds of an input is simulated in compiled code, and its moments are
    exact, as those of the plant `linear`.
    """
    A, B, C, D = system.sampled(system.nominal, Ts)
    named = system.signals({})
    signals = system.signals(bounds_by_name(bounds or {}, named.states, named.inputs))
    if system.nominal or signals.limits_inputs:
        return ParametricLinear(Ts, system, signals, bool(D.any()))
    given = {"A": A[None], "B": B[None], "C": C[None], "Bw": 1.0, "Dv": 1.0, "D": D[None]}
    return FixedLinear(uncertain_system(n_steps, given), NOT_UNCERTAIN, Ts, signals=signals, A_c=system.A_c)


def design(
    Ts: float, n_steps: int, *, A: SystemMatrix, B: SystemMatrix = None, C: SystemMatrix, D: SystemMatrix = None
) -> UncertainLinear:
    """Linear system with one noise per state and one per output.

    A state-space model from the matrices A, B, C, D, also those of a .mat file: `A: {file: system.mat, name: A}`.
    A missing matrix is zero; B, C and D are lists of rows.  Entries may depend on k.

    Parameters
    ----------
    Ts : sampling time [s]
    n_steps : number of control periods N
    A : (nx, nx) state matrix
    B : (nx, nu) input matrix
    C : (ny, nx) output matrix
    D : (ny, nu) feedthrough of the input that acts at k

    Raises
    ------
    DesignError
        If the sizes are inconsistent, or an entry is undefined at some k.
    """
    given = {"A": A, "B": B, "C": C, "Bw": 1.0, "Dv": 1.0, "D": D}
    return UncertainLinear(uncertain_system(n_steps, given), NOT_UNCERTAIN, Ts)
