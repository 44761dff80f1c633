"""Oracle estimator: Kalman filter or predictor that knows the true uncertainty matrices F at every step.

Bound   A lower bound of the error for estimators without this knowledge: with Gaussian noises of known covariance no
        one-step predictor (with `form: filter` no filter) has a smaller mean square error; with other noises no linear
        one.
Model   The matrices of the plant with the F of the run, A + H_A F_x G_x and so on, and the covariances of w and v of
        the design model.  F(k) is known at k.  P is the covariance of x_pred - x given the F of the run.
Source  Kalman filter with correlated noises; a lower bound in addition to souto2011.
Missing An output that is missing (NaN) is left out of the gain and of P of its run.
Limit   Without uncertainty the Kalman predictor.
Cost    One Riccati step per run and step.
Fails   Design error if plant and model are not of a kind with uncertain matrices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import Form
from rmpc_bench.models.disturbed import DisturbedUncertain, augmented_system
from rmpc_bench.models.uncertain_linear import UncertainModel
from rmpc_bench.models.uncertain_system import UncertainSystem
from rmpc_bench.numerics.linalg import check_signal, check_time, driven, mv
from rmpc_bench.numerics.square_root import conditional, corrected, covariance_of, root_of
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Plant, as_estimate

EQUATION = r"""\hat x_{k+1|k} = A_k^F \hat x_{k|k-1} + B u_k + K_k (y_k - C_k^F \hat x_{k|k-1}), \quad
A_k^F = A + H_A F_x(k) G_x"""


class OracleState(NamedTuple):
    """State of the estimator between steps."""

    x_pred: Float[Array, "runs nx"]
    root: Float[Array, "runs nx nx"]  # root of the covariance of x_pred - x
    e: Float[Array, "runs ny"]
    K: Float[Array, "runs nx ny"]
    F_x: Float[Array, "runs samples rx sx"]
    F_w: Float[Array, "runs samples rw sw"]
    F_v: Float[Array, "runs samples rv sv"]


@dataclass(frozen=True, eq=False)
class Oracle(Estimator):
    """A filter or predictor that knows the uncertain matrices of every run."""

    system: UncertainSystem  # matrices of the plant
    model: UncertainModel  # design model, for the noises
    x0: Float[Array, " nx"]  # x0, P0: prediction before the first measurement and covariance of its error
    P0: Float[Array, "nx nx"]
    form: Form = "predictor"  # whether x_hat(k) uses y(k)

    knows_uncertainty = True
    bridges_missing = True

    def init(self, n_runs: int, delta: Any = ()) -> OracleState:
        """Start every run at ``x0``; ``delta`` contains the F of all runs."""
        nx, ny = self.system.size("nx"), self.system.size("ny")
        return OracleState(
            np.tile(self.x0, (n_runs, 1)),
            np.tile(root_of(self.P0), (n_runs, 1, 1)),
            np.zeros((n_runs, ny)),
            np.zeros((n_runs, nx, ny)),
            *delta,
        )

    def correct(self, k: int, state: OracleState, y: Float[Array, "runs ny"]) -> tuple[OracleState, Estimate]:
        """Compute the gain of every run and use y(k); the estimate of a predictor is x_pred(k)."""
        check_time(k, state.F_x.shape[1])
        check_signal("y", y, *state.e.shape)
        m, x_pred, root = self.system.at(k), state.x_pred, state.root
        F_x, F_w, F_v = (each[:, k] for each in (state.F_x, state.F_w, state.F_v))
        A, C = _sum(m.A, m.H_A, F_x, m.G_x), _sum(m.C, m.H_C, F_x, m.G_x)
        B = np.concatenate([_sum(m.Bw, m.H_Bw, F_w, m.G_w), _sum(m.Bv, m.H_Bv, F_v, m.G_v)], axis=2)
        D = np.concatenate([_sum(m.Dw, m.H_Dw, F_w, m.G_w), _sum(m.Dv, m.H_Dv, F_v, m.G_v)], axis=2)
        mean, joint = self.model.noise
        missing = np.isnan(y)
        # An output that is missing becomes one that depends on nothing.
        C, D = (np.where(missing[:, :, None], 0.0, each) for each in (C, D))
        own = missing[:, :, None] * np.eye(y.shape[1])
        noise = root_of(joint)
        Y = np.concatenate([C @ root, D @ noise, own], axis=2)
        ahead = conditional(Y, np.concatenate([A @ root, B @ noise, np.zeros((*A.shape[:2], y.shape[1]))], axis=2))
        e = y - mv(C, x_pred) - np.einsum("rij,j->ri", D, mean)
        moved = mv(A, x_pred) + np.einsum("rij,j->ri", B, mean)
        used = np.where(missing, 0.0, e)
        after = state._replace(x_pred=moved, root=ahead.root, e=used, K=ahead.gain)
        x_hat, of_x_hat = x_pred, root
        if self.form == "filter":
            found = corrected(C, Y[:, :, root.shape[2] :], root)
            x_hat, of_x_hat = x_pred + mv(found.gain, used), found.root
        return after, as_estimate(Estimate(x_hat, covariance_of(of_x_hat), info={"e": e}))

    def predict(self, k: int, state: OracleState, u: Float[Array, "runs nu"]) -> OracleState:
        """Predict k+1."""
        B = self.system.at(k).B
        return state._replace(x_pred=state.x_pred + mv(state.K, state.e) + driven(B, u))


def _sum(M: Array, H: Array, F: Array, G: Array) -> Float[Array, "runs n m"]:
    """Return M + H F G for the F of every run."""
    total: Array = M + np.einsum("ij,rjk,kl->ril", H, F, G)
    return total


def design(
    model: Any,
    n_steps: int,
    plant: Plant,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    form: Form = "predictor",
) -> Oracle:
    """Kalman filter or predictor that knows every F: a lower bound for comparison, not a realisable method.

    Parameters
    ----------
    model : uncertain linear model with the covariances of the noises
    n_steps : number of control periods N
    plant : uncertain linear plant, whose matrices the estimator uses
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    form : `predictor` does not use y(k) for x_hat(k); `filter` does

    Raises
    ------
    DesignError
        If plant or model has no uncertain matrices, or their sizes differ.
    """
    if not isinstance(model, UncertainModel) or plant.system is None:
        raise DesignError("needs plant and model of a kind with uncertain matrices, such as uncertain-linear")
    system = plant.system
    if isinstance(model, DisturbedUncertain) and system.size("nx") == model.undisturbed.nx:
        system = augmented_system(system, model.entry)
    for size in ("nx", "nu", "ny", "nw", "nv"):
        of_plant, of_model = system.size(size), model.system.size(size)
        if of_plant != of_model:
            raise DesignError(f"plant and model must have the same sizes; {size} is {of_plant} and {of_model}")
    return Oracle(system, model, x0, P0, form)
