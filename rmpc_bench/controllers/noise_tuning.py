"""Output weights adapted to the noise: bounds and correlation over the last samples by linear programming.

Model   P y = C x_hat + n,  L x_hat = x_tilde + nu,  x_tilde(k) = A x_hat(k-1) + B u(k-1);  P = I + Pi, L = I + Lambda
        are upper triangular, |n_i| <= r_i and |nu_i| <= rho_i.  LP2, (22)-(27): over the last Ne2 + 1 samples choose
        Pi, Lambda, r and rho with the least sum of all r_i and rho_i.  As n is uniform on its box,
        C_y = c P^-1 D^2 P^-T, D = diag(r), c = 1/3 (28), and the output weight is kp C_y^-1 = (kp / c) P' D^-2 P (16),
        clipped.
Source  belda2017, sections III-C and V.
Solution LP2 separates into rows.  Row i of P minimises r_i such that |e_i + sum_{j>i} pi_ij z_j| <= r_i at all samples,
        e = y - C x_hat, z = y: a minimax fit of ny - i unknowns.  The rows of L are computed in the same way.  Lambda
        and rho do not affect the control.
Assumed `form: corrected` uses c = 1/3, the variance of a uniform distribution of half-width 1, as the text about (28)
        and C_x do; `printed` uses the 1/2 of (28).  (27) is printed with y - C x_hat in its lower part, but (24)
        requires C x_hat - y; the printed sign would give -Pi.  Both forms use the sign of (24).
        `on: output` multiplies Pi by y, as (24) does.  The result depends on the origin, and correlation of noise that
        is small compared with y has no effect.  `on: residual` multiplies Pi by e, and Lambda by x_hat - x_tilde.
        `on: none` sets Pi and Lambda to zero, so that r is the largest residual of every output and C_y is diagonal.
        `weight: root` uses the result as Q_yw of (7), where it is squared; the published bounds refer to this form.
        `weight: square` uses it as Q_yw' Q_yw, as in (16), with negative eigenvalues after clipping set to 0.
        Diagonal entries are clipped to [lower, upper], the others to [-upper, upper].  Values of r and rho below
        `floor` are replaced by `floor`.  Before k = Ne2 + Ne, when all estimates in the window come from full windows,
        and if a fit fails or a value is NaN, the weight does not change.
Limit   Without noise kp / (c floor^2) exceeds the upper bound, so that the diagonal equals that bound.  For one output
        the weight is kp / (c max e^2), clipped.
Cost    ny + nx minimax fits of Ne2 + 1 points per run and step: 25 us for three outputs and six states, 7 us without
        `state_rows`.
Fails   Design error if the window has fewer samples than a row has coefficients, or the bounds are in the wrong order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.linalg import appended, psd_sqrt
from rmpc_bench.numerics.minimax import fit
from rmpc_bench.types import Array, Count, NonNegative, Positive

UNIFORM = 1.0 / 3.0
"""Variance of a uniform distribution of half-width 1."""
PRINTED = 1.0 / 2.0
"""Factor as printed in (28)."""


@dataclass(frozen=True)
class ConstantTuning:
    """Constant output weight.

    Parameters
    ----------
    kind : `constant` has no further keys
    """

    kind: Literal["constant"] = "constant"


@dataclass(frozen=True)
class LpNoise:
    """Output weight from bounds of the noise over the last samples.

    Parameters
    ----------
    kind : `lp-noise` has the keys below
    Ne2 : length of the window, which has Ne2 + 1 samples (default 14)
    kp : factor of the inverse covariance (default 1e-7)
    bounds : [lower, upper] bounds of the diagonal of the weight; other entries lie in [-upper, upper] (default
        [0.5, 4.0])
    form : `corrected` (default) uses the variance of a uniform distribution in (28), `printed` the 1/2 of the paper
    on : `output` (default) multiplies the correlation by outputs as in (24), `residual` by residuals, `none` has no
        correlation
    weight : `root` (default) uses the result as Q_yw of (7), `square` as Q_yw' Q_yw
    floor : lower limit of the bounds of the noise (default 1e-6)
    state_rows : whether to estimate bounds and correlation of the process noise, too; the control does not depend on
        them (default true)
    """

    kind: Literal["lp-noise"] = "lp-noise"
    Ne2: Count = 14
    kp: Positive = 1e-7
    bounds: tuple[NonNegative, Positive] = (0.5, 4.0)
    form: Literal["corrected", "printed"] = "corrected"
    on: Literal["output", "residual", "none"] = "output"
    weight: Literal["root", "square"] = "root"
    floor: Positive = 1e-6
    state_rows: bool = True


class TuningData(NamedTuple):
    """Data of LP2 at one sample, or of a window with axis 1 = sample."""

    y: Float[Array, "runs *samples ny"]
    y_hat: Float[Array, "runs *samples ny"]  # C x_hat
    x_hat: Float[Array, "runs *samples nx"]
    x_tilde: Float[Array, "runs *samples nx"]  # state predicted from the previous estimate and input


class Triangle(NamedTuple):
    """Upper triangular T with unit diagonal and the half-widths of T z - z + e; NaN without a solution."""

    T: Float[Array, "runs n n"]
    width: Float[Array, "runs n"]


def fitted(e: Float[Array, "runs samples n"], z: Float[Array, "runs samples n"]) -> Triangle:
    """Minimise the largest |e_i + sum_{j>i} T_ij z_j| over the samples, row by row of T."""
    runs, samples, n = e.shape
    T, width, one_group = np.tile(np.eye(n), (runs, 1, 1)), np.empty((runs, n)), np.zeros(samples, dtype=np.int64)
    for i in range(n):
        found = fit(-z[:, :, i + 1 :], e[:, :, i], one_group)
        T[:, i, i + 1 :], width[:, i] = found.x, found.r[:, 0]
    return Triangle(T, width)


def uncorrelated(e: Float[Array, "runs samples n"]) -> Triangle:
    """Return the largest |e_i| over the samples, with T = I; NaN or inf makes the half-width NaN, as in `fitted`."""
    runs, _, n = e.shape
    width = np.abs(e).max(axis=1)
    return Triangle(np.tile(np.eye(n), (runs, 1, 1)), np.where(np.isfinite(width), width, np.nan))


def covariance(box: Triangle, c: float) -> Float[Array, "runs n n"]:
    """Return the covariance c T^-1 D^2 T^-T of n, if T n is uniform with the half-widths D."""  # (28)
    n = box.T.shape[1]
    inverse = np.tile(np.eye(n), (len(box.T), 1, 1))
    for i in range(n - 2, -1, -1):
        for j in range(i + 1, n):
            inverse[:, i] -= box.T[:, i, j, None] * inverse[:, j]
    return c * _squared((inverse * box.width[:, None]).swapaxes(1, 2))


def precision(box: Triangle, c: float) -> Float[Array, "runs n n"]:
    """Return the inverse of the covariance, T' D^-2 T / c, without a matrix inversion."""
    return _squared(box.T / box.width[:, :, None]) / c


def _squared(S: Float[Array, "runs n n"]) -> Float[Array, "runs n n"]:
    """Return S' S as a sum over the rows of S, in an order that does not depend on the number of runs."""
    total = np.zeros_like(S)
    for i in range(S.shape[1]):
        total += S[:, i, :, None] * S[:, i, None, :]
    return total


@dataclass(frozen=True, eq=False)
class NoiseTuning:
    """LP2 and the output weight that follows from it."""

    keys: LpNoise  # options of the tuning
    start: int  # first sample at which LP2 is solved
    nx: int  # nx, ny: numbers of states and outputs
    ny: int

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """What `info` has."""
        found = {"Pi": (self.ny, self.ny), "r_breve": (self.ny,), "C_y": (self.ny, self.ny)}
        if self.keys.state_rows:
            found |= {"Lambda": (self.nx, self.nx), "rho_breve": (self.nx,), "C_x": (self.nx, self.nx)}
        return found

    def init(self, n_runs: int) -> Float[Array, "runs samples numbers"]:
        """Return an empty window (NaN)."""
        numbers = 2 * self.ny + (2 * self.nx if self.keys.state_rows else 0)
        return np.full((n_runs, self.keys.Ne2 + 1, numbers), np.nan)

    def moved(
        self, window: Float[Array, "runs samples numbers"], now: TuningData
    ) -> Float[Array, "runs samples numbers"]:
        """Return the window with a new sample appended and the oldest removed."""
        last = np.concatenate(now if self.keys.state_rows else now[:2], axis=1)
        return appended(window, last)

    def penalties(
        self, k: int, window: Float[Array, "runs samples numbers"], Q_yw: Float[Array, "runs ny ny"]
    ) -> tuple[Float[Array, "runs ny ny"], dict[str, Array]]:
        """Return the output weights at k and the solution of LP2; weights without a solution do not change."""
        runs = len(window)
        if k < self.start:
            return Q_yw, {name: np.full((runs, *shape), np.nan) for name, shape in self.reports.items()}
        y, y_hat, rest = np.split(window, [self.ny, 2 * self.ny], axis=2)
        box = self._fit(y, y_hat)
        c = PRINTED if self.keys.form == "printed" else UNIFORM
        info = {"Pi": box.T - np.eye(self.ny), "r_breve": box.width, "C_y": covariance(self._floored(box), c)}
        if self.keys.state_rows:
            x_box = self._fit(rest[:, :, : self.nx], rest[:, :, self.nx :])
            C_x = covariance(self._floored(x_box), UNIFORM)
            info |= {"Lambda": x_box.T - np.eye(self.nx), "rho_breve": x_box.width, "C_x": C_x}
        found = self._clipped(self.keys.kp * precision(self._floored(box), c))  # (16)
        good = np.asarray(np.isfinite(found).all(axis=(1, 2)))
        return np.where(good[:, None, None], self._root(found, good), Q_yw), info

    def _fit(self, z: Float[Array, "runs samples n"], z_hat: Float[Array, "runs samples n"]) -> Triangle:
        e = z - z_hat
        if self.keys.on == "none":
            return uncorrelated(e)
        return fitted(e, e if self.keys.on == "residual" else z)

    def _floored(self, box: Triangle) -> Triangle:
        return box._replace(width=np.maximum(box.width, self.keys.floor))

    def _clipped(self, Q: Float[Array, "runs n n"]) -> Float[Array, "runs n n"]:
        lower, upper = self.keys.bounds
        clipped = np.clip(Q, -upper, upper)
        i = np.arange(Q.shape[1])
        clipped[:, i, i] = np.maximum(clipped[:, i, i], lower)
        return clipped

    def _root(self, Q: Float[Array, "runs n n"], good: Bool[Array, " runs"]) -> Float[Array, "runs n n"]:
        """Return the Q_yw of (7) for a weight Q."""
        return psd_sqrt(np.where(good[:, None, None], Q, 0.0)) if self.keys.weight == "square" else Q
