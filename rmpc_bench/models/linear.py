"""The linear model x(k+1) = A x(k) + B u(k) + f0 + w(k), y(k) = C x(k) + D u(k) + d0 + v(k)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from rmpc_bench.models.matrix_sizes import Sizes, sizes_of
from rmpc_bench.numerics.linalg import as_covariance, is_possible, mv, real_numbers
from rmpc_bench.types import Array, DesignError, Matrix, Model, OperatingPoint
from rmpc_bench.types.basics import attribute

Rows = Array | list[list[float]]
Given = Array | Matrix
SIZES: Sizes = {"A": ("nx", "nx"), "B": ("nx", "nu"), "C": ("ny", "nx")}


@dataclass(frozen=True, eq=False, init=False)
class LinearModel(Model):
    """A linear model with white noises at one k, or at every k if nothing varies.

    Parameters
    ----------
    A : (nx, nx) state matrix; a list is its diagonal
    B : (nx, nu) input matrix, row by row
    C : (ny, nx) output matrix, row by row
    Q_w : (nx, nx) covariance of the process noise w, positive semidefinite; a number or a diagonal is expanded
    R_v : (ny, ny) covariance of the measurement noise v, given in the same ways
    S_wv : (nx, ny) cross-covariance E w v', zero by default
    f0 : (nx,) constant part of x(k+1), zero by default
    d0 : (ny,) constant part of y(k), zero by default
    D : (ny, nu) feedthrough of the input, zero by default; estimators get y - D u
    extra_signals : name -> rows Z of a signal z = Z x that limits may name, none by default
    disturbance_inputs : name -> B_d of a place where `disturbance` of a configuration may enter, none by default

    Raises
    ------
    DesignError
        If the shapes are inconsistent, or a covariance is not positive semidefinite.

    Examples
    --------
    >>> LinearModel([0.9, 0.8], [[0.0], [1.0]], [[1.0, 1.0]], 0.01, 0.04).Q_w.tolist()
    [[0.01, 0.0], [0.0, 0.01]]
    """

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    Q_w: Float[Array, "nx nx"]
    R_v: Float[Array, "ny ny"]
    S_wv: Float[Array, "nx ny"]
    f0: Float[Array, " nx"]
    d0: Float[Array, " ny"]
    D: Float[Array, "ny nu"]
    extra_signals: Mapping[str, Float[Array, "nz nx"]]
    disturbance_inputs: Mapping[str, Float[Array, "nx nd"]]

    is_linear_model = True

    def __init__(
        self,
        A: Given,
        B: Given,
        C: Given,
        Q_w: Given,
        R_v: Given,
        *,
        S_wv: Rows | None = None,
        f0: Array | list[float] | None = None,
        d0: Array | list[float] | None = None,
        D: Rows | None = None,
        extra_signals: Mapping[str, Array] | None = None,
        disturbance_inputs: Mapping[str, Array] | None = None,
    ) -> None:
        found = vars(self)
        found.update(_system({"A": A, "B": B, "C": C}))
        nx, ny = len(self.A), len(self.C)
        for name, cov, n in (("Q_w", Q_w, nx), ("R_v", R_v, ny)):
            array = _array(name, cov)
            try:
                found[name] = as_covariance(array, n)
            except ValueError as error:
                raise DesignError(f"{name}: {error}") from None
        of_u = ("D", D, (ny, self.B.shape[1]))
        for name, value, shape in (("S_wv", S_wv, (nx, ny)), ("f0", f0, (nx,)), ("d0", d0, (ny,)), of_u):
            array = np.zeros(shape) if value is None else _array(name, value)
            if array.shape != shape:
                turned = ", as its transpose has" if len(shape) == 2 and array.T.shape == shape else ""
                raise DesignError(f"{name} has shape {array.shape}; {shape} fits the other matrices{turned}")
            found[name] = array
        if not is_possible(self.S_wv, self.Q_w, self.R_v):
            raise DesignError("S_wv: [Q_w S_wv; S_wv' R_v] is not positive semidefinite", "S_wv")
        found.update(extra_signals=dict(extra_signals or {}), disturbance_inputs=dict(disturbance_inputs or {}))

    def at(self, k: int) -> LinearModel:
        """Return the model at k, which is the same at every k."""
        return self

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.A)

    @attribute
    def nu(self) -> int:
        """Number of inputs."""
        return int(self.B.shape[1])

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.C)

    # The functions of a nonlinear model (models/nonlinear.py), so that an estimator written for one has this one, too.

    @property
    def limits(self) -> tuple[Float[Array, " nx"], Float[Array, " nx"]]:
        """Lower and upper bounds of the states: infinite."""
        return np.full(self.nx, -np.inf), np.full(self.nx, np.inf)

    def f(self, x: ArrayLike, u: ArrayLike, k: int = 0) -> Float[Array, "*n nx"]:
        """Return x(k+1) = A x + B u + f0 without noise, of a state and an input or of one per row.

        Examples
        --------
        >>> model = LinearModel([[0.5]], [[1.0]], [[2.0]], 1.0, 1.0, f0=[3.0])
        >>> model.f([2.0], [1.0]), model.F([2.0], [1.0]), model.h([2.0]), model.H([2.0])
        (array([5.]), array([[0.5]]), array([4.]), array([[2.]]))
        """
        return _product(self.A, x) + _product(self.B, u) + self.f0

    def h(self, x: ArrayLike) -> Float[Array, "*n ny"]:
        """Return y = C x + d0 without noise."""
        return _product(self.C, x) + self.d0

    def F(self, x: ArrayLike, u: ArrayLike, k: int = 0) -> Float[Array, "nx nx"]:
        """Return the derivative A of f."""
        return self.A

    def H(self, x: ArrayLike) -> Float[Array, "ny nx"]:
        """Return the derivative C of h."""
        return self.C


class HeldModel(LinearModel):
    """A constant linear model over several samples with the input held, for a controller that is called so rarely.

    Inputs that the controller has not are those of the operating point.
    """

    def __init__(self, model: Model, every: int, inputs: Sequence[int] | None = None) -> None:
        if model.varies:
            raise DesignError("this model varies with k")
        now: LinearModel = model.at(0)
        A, held, Q_w = np.eye(now.nx), np.zeros((now.nx, now.nx)), np.zeros((now.nx, now.nx))
        for _ in range(every):
            A, held, Q_w = now.A @ A, held + A, Q_w + A @ now.Q_w @ A.T
        point, rest = model.operating_point, np.zeros(now.nu)
        if inputs is not None:
            rest = np.where(np.isin(np.arange(now.nu), inputs), 0.0, model.u_op)
            point = None if point is None else OperatingPoint(point.x, point.u[[*inputs]], point.y)
        B, D = (now.B, now.D) if inputs is None else (now.B[:, [*inputs]], now.D[:, [*inputs]])
        f0, Q_w = held @ (now.f0 + now.B @ rest), 0.5 * (Q_w + Q_w.T)
        super().__init__(A, held @ B, now.C, Q_w, now.R_v, f0=f0, d0=now.d0, D=D, extra_signals=model.extra_signals)
        own = {"of": model, "every": every, "held": held, "operating_point": point, "inputs": inputs}
        vars(self).update(own, n_disturbances=model.n_disturbances)

    of: Model
    every: int
    inputs: Sequence[int] | None
    held: Float[Array, "nx nx"]
    """Sum of A^i: what a constant addition to x(k+1) adds up to."""

    @property
    def undisturbed(self) -> Model:
        """The model without its disturbances."""
        return HeldModel(self.of.undisturbed, self.every, self.inputs) if self.n_disturbances else self

    @property
    def deviation(self) -> Model:
        """The model of x - x_op, u - u_op and y - y_op."""
        return self if self.of.deviation is self.of else HeldModel(self.of.deviation, self.every, self.inputs)


def _product(matrix: Array, x: ArrayLike) -> Array:
    """Multiply a vector, or every row, by a matrix."""
    rows = np.asarray(x, dtype=float)
    return mv(matrix, np.atleast_2d(rows)).reshape(*rows.shape[:-1], len(matrix))


def _array(name: str, value: Given | Rows) -> Array:
    """Return finite numbers as an array."""
    try:
        array = real_numbers(value)
    except ValueError:
        raise DesignError(f"{name} must be numbers, row by row (got {value!r:.60})") from None
    if not np.isfinite(array).all():
        raise DesignError(f"{name} must be finite numbers")
    return array


def _system(given: Mapping[str, Given]) -> dict[str, Array]:
    """Return A, B and C as matrices; a number is a matrix of one entry, a list the diagonal of A."""
    read = {}
    for name, value in given.items():
        array = _array(name, value)
        read[name] = array.reshape(1, 1, 1) if array.ndim == 0 else array[None]
        if array.ndim > 2:
            raise DesignError(f"{name} has shape {array.shape}; a matrix is expected")
    try:
        sizes_of(read, SIZES)
    except DesignError as error:
        raise DesignError(f"{error.parameter}: {error}") from None
    return {name: np.diag(array[0]) if array.ndim == 2 else array[0] for name, array in read.items()}
