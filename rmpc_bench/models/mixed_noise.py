"""Linear design model with stochastic and bounded noises.

Model   x(k+1) = A_k x + B_k u + w,  w = w_mean + w_s + w_b,  w_s ~ N(0, P_w(k)),  w_b in E(0, M_w(k)),
        y(k)   = C_k x + v,          v = v_mean + v_s + v_b,  v_s ~ N(0, P_v(k)),  v_b in E(0, M_v(k)),
        E(0, M) = {z : z' M^-1 z <= 1}.  A singular M is a flat set; M = 0 means no bounded noise.
Source  ma2025, (3)-(10).  The paper's P^w_k, M^w_k and H_k are P_w(k), M_w(k) and C_k here; known means are added.
Time    The horizon of a controller exceeds the last step, so that a matrix has a value at every k.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.matrix_sizes import expanded, sizes_of
from rmpc_bench.models.noise_sets import SAME_SCALE, NoiseScale
from rmpc_bench.models.uncertain_system import depends_on_k, entries_of, values_at
from rmpc_bench.numerics.linalg import as_covariance, as_vector
from rmpc_bench.types import Array, DesignError, Model, SystemMatrix

EQUATION = r"""x_{k+1} = A_k x_k + B_k u_k + w_k, \quad y_k = C_k x_k + v_k, \quad
w_k = \bar w + w_k^s + w_k^b, \quad w_k^s \sim \mathcal{N}(0, P_w), \quad w_k^{b \top} M_w^{-1} w_k^b \le 1"""


TABLE: Mapping[str, tuple[str, str]] = {
    "A": ("nx", "nx"), "B": ("nx", "nu"), "C": ("ny", "nx"),
    "P_w": ("nx", "nx"), "M_w": ("nx", "nx"), "P_v": ("ny", "ny"), "M_v": ("ny", "ny"), "D": ("ny", "nu"),
}  # fmt: skip
"""Matrix -> number of its rows and of its columns: states, inputs or outputs."""

LINEAR_PART = ("A", "B", "C", "P_w", "P_v", "D")
"""Matrices of a `LinearModel`."""


class MatrixOverTime(NamedTuple):
    """A matrix that may vary with k: the given entries and the size."""

    name: str
    given: Array  # entries as objects (numbers or functions of ``{"k": k}``), or an array (k, rows, columns)
    shape: tuple[int, int]

    @property
    def varies(self) -> bool:
        """Whether the matrix depends on k."""
        return len(self.given) > 1 if self.given.ndim == 3 else depends_on_k(self.given)

    def at(self, k: int) -> Float[Array, "rows columns"]:
        """Return the matrix at k."""
        if self.given.ndim == 3 and self.varies and k >= len(self.given):
            raise DesignError(
                f"has {len(self.given)} entries over k, but k = {k} is needed: the horizon of a controller exceeds "
                "the last step",
                self.name,
            )
        matrix = expanded(self.name, _values(self.name, self.given, k), self.shape)[0]
        try:
            found: Array = matrix if self.name in ("A", "B", "C", "D") else as_covariance(matrix, len(matrix))
        except ValueError as error:
            raise DesignError(f"{error} (k = {k})" if self.varies else str(error), self.name) from None
        return found


@dataclass(frozen=True, eq=False)
class MixedModel(Model):
    """A linear model with stochastic and bounded noises."""

    matrices: Mapping[str, MatrixOverTime]  # matrices by the names of `TABLE`
    w_mean: Float[Array, " nx"]  # w_mean, v_mean: known means of the noises
    v_mean: Float[Array, " ny"]
    scale: NoiseScale = SAME_SCALE  # factors on the standard deviations of the stochastic noises
    _made: dict[tuple[str, int], Any] = field(default_factory=dict, init=False, repr=False)
    """Cache of evaluated matrices by name and k; a constant one is stored at k = 0."""

    has_sets = True
    nx = property(lambda self: self.matrices["A"].shape[0])
    nu = property(lambda self: self.matrices["B"].shape[1])
    ny = property(lambda self: self.matrices["C"].shape[0])
    varies = property(lambda self: any(self.matrices[name].varies for name in LINEAR_PART))
    feedthrough = property(lambda self: self.matrices["D"].varies or bool(self.at(0).D.any()))
    w_law = property(lambda self: (self.w_mean, self.at(0).Q_w))
    v_law = property(lambda self: (self.v_mean, self.at(0).R_v))

    def at(self, k: int) -> LinearModel:
        """Return the model at k >= 0 with the stochastic noises only."""
        k = k if self.varies else 0
        if ("", k) not in self._made:
            A, B, C, P_w, P_v, D = (self._at(name, k) for name in LINEAR_PART)
            self._made["", k] = LinearModel(A, B, C, P_w, P_v, f0=self.w_mean, d0=self.v_mean, D=D)
        return self._made["", k]

    def M_w(self, k: int) -> Float[Array, "nx nx"]:
        """Return the shape matrix of the set of the bounded process noise at k >= 0."""
        return self._at("M_w", k)

    def M_v(self, k: int) -> Float[Array, "ny ny"]:
        """Return the shape matrix of the set of the bounded measurement noise at k >= 0."""
        return self._at("M_v", k)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without the cache; a worker fills its own."""
        return {**vars(self), "_made": {}}

    @property
    def _factors(self) -> Mapping[str, float]:
        return {"P_w": self.scale.process**2, "P_v": self.scale.measurement**2}

    def _at(self, name: str, k: int) -> Array:
        k = k if self.matrices[name].varies else 0
        if (name, k) not in self._made:
            self._made[name, k] = self._factors.get(name, 1.0) * self.matrices[name].at(k)
        return self._made[name, k]


def design(
    n_steps: int,
    *,
    A: SystemMatrix,
    B: SystemMatrix = None,
    C: SystemMatrix,
    D: SystemMatrix = None,
    P_w: SystemMatrix = 0.0,
    M_w: SystemMatrix = 0.0,
    P_v: SystemMatrix = 0.0,
    M_v: SystemMatrix = 0.0,
    w_mean: float | list[float] = 0.0,
    v_mean: float | list[float] = 0.0,
    scale: NoiseScale | None = None,
) -> MixedModel:
    """Linear model with stochastic and bounded noises; `from: plant` uses the plant's A, B, C and D.

    A missing matrix is zero; B, C and D are lists of rows.  Entries may depend on k.

    Parameters
    ----------
    n_steps : number of control periods N
    A : (nx, nx) state matrix
    B : (nx, nu) input matrix
    C : (ny, nx) output matrix
    D : (ny, nu) feedthrough of the input that acts at k
    P_w : (nx, nx) covariance of the stochastic process noise
    M_w : (nx, nx) shape matrix of the ellipsoid E(0, M_w) that contains the bounded process noise
    P_v : (ny, ny) covariance of the stochastic measurement noise
    M_v : (ny, ny) shape matrix of the ellipsoid E(0, M_v) that contains the bounded measurement noise
    w_mean : (nx,) known mean of the process noise
    v_mean : (ny,) known mean of the measurement noise
    scale : factors on the standard deviations of the stochastic noises, such as {measurement: 0.1}; the sets stay

    Raises
    ------
    DesignError
        If the sizes are inconsistent, or a covariance or shape matrix is undefined or not positive semidefinite at
        some k.
    """
    matrices = _read({"A": A, "B": B, "C": C, "P_w": P_w, "M_w": M_w, "P_v": P_v, "M_v": M_v, "D": D})
    means = {}
    for name, mean, matrix in (("w_mean", w_mean, "P_w"), ("v_mean", v_mean, "P_v")):
        means[name] = as_vector(mean, matrices[matrix].shape[0], name)
    # Evaluate every k of the experiment now, so that an invalid entry is an error of the design.
    for each in matrices.values():
        for k in range(n_steps + 1 if each.varies else 1):
            each.at(k)
    return MixedModel(matrices, means["w_mean"], means["v_mean"], scale or SAME_SCALE)


def _read(values: Mapping[str, Any]) -> dict[str, MatrixOverTime]:
    """Read the matrices by name and determine their sizes; A and C are required."""
    for name in ("A", "C"):
        if values[name] is None:
            raise DesignError(f"the matrix {name} is missing", name)
    given = {name: entries_of(name, 0.0 if value is None else value) for name, value in values.items()}
    sizes = sizes_of({name: _values(name, entries, 0) for name, entries in given.items()}, TABLE)
    return {name: MatrixOverTime(name, given[name], (sizes[a], sizes[b])) for name, (a, b) in TABLE.items()}


def _values(name: str, given: Array, k: int) -> Array:
    """Return the numbers at k with a leading axis of length 1."""
    if given.ndim == 3:
        return given[k : k + 1] if len(given) > 1 else given
    return values_at(name, given, k)[None]
