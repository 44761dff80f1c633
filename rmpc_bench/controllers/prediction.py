"""Models of predictions that are constant over the horizon, and the tracking problems of `mpc`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.state_dependent import Affine
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.tracking import Problem
from rmpc_bench.types import Array


class Frozen(NamedTuple):
    """A model that is constant over the horizon."""

    A: Float[Array, "nx nx"] | Float[Array, "runs nx nx"]
    B: Float[Array, "nx nu"] | Float[Array, "runs nx nu"]
    f: Float[Array, " nx"]
    C: Float[Array, "ny nx"]
    d: Float[Array, " ny"]


def frozen(now: LinearModel) -> Frozen:
    """Return the model of x and y with the input u - u_op, whose constant part contains B u_op."""
    f = now.f0 if now.operating_point is None else now.f0 + now.B @ now.u_op
    return Frozen(now.A, now.B, f, now.C, now.d0)


def with_mean(now: Frozen) -> Frozen:
    """Extend a model by a constant mean of the process noise as additional states: [x; mean]."""
    nx = now.A.shape[-1]
    nothing = np.zeros((nx, nx))
    A = np.block([[now.A, np.eye(nx)], [nothing, np.eye(nx)]])
    B, C = np.vstack([now.B, np.zeros_like(now.B)]), np.hstack([now.C, np.zeros_like(now.C)])
    return Frozen(A, B, np.concatenate([now.f, np.zeros(nx)]), C, now.d)


def with_output(now: Affine) -> Frozen:
    """Return a linearisation of every run as a model with a shared output matrix: its states are [x; y; 1]."""
    n_runs, ny, nx = now.C.shape
    nu, size = now.B.shape[2], nx + ny + 1
    A, B = np.zeros((n_runs, size, size)), np.zeros((n_runs, size, nu))
    A[:, :nx, :nx], A[:, :nx, -1], A[:, -1, -1] = now.A, now.f, 1.0
    A[:, nx:-1, :nx] = np.einsum("rij,rjk->rik", now.C, now.A)
    A[:, nx:-1, -1] = mv(now.C, now.f) + now.d
    B[:, :nx], B[:, nx:-1] = now.B, np.einsum("rij,rjk->rik", now.C, now.B)
    return Frozen(A, B, np.zeros(size), np.eye(ny, size, nx), np.zeros(ny))


def of_moves(
    models: Sequence[LinearModel], root_Q: Array, root_R: Array, Hp: int, Hu: int, *, uses_mean: bool
) -> Problem:
    """Return the problem of cost (2) of mpc.py: states [x; u(k-1); mean of the noise], inputs are the increments.

    The models are those of k..k+Hp, or a constant one.
    """
    parts = [_augmented(model, uses_mean=uses_mean) for model in models]
    steps = [(*now[:3], after[3]) for now, after in pairwise(parts)]
    D = models[0].D if models[0].feedthrough else None
    return Problem(*parts[0], root_Q, root_R, Hp, Hu, over=steps or None, D=D)


def of_inputs(
    models: Sequence[LinearModel], root_Q: Array, root_R: Array, Hp: int, Hu: int, *, uses_mean: bool
) -> Problem:
    """Return the same problem with |u - u_op|^2 in place of |du|^2: inputs are u - u_op, the last one is held."""
    (model,) = models
    A, B, f, C = _augmented(model, uses_mean=uses_mean)
    head, inputs = A.copy(), slice(model.nx, model.nx + model.nu)
    head[:, inputs] = 0.0
    acting = head, B, f + B @ model.u_op, C
    return Problem(*acting, root_Q, root_R, Hp, Hu, over=[acting] * Hu + [(A, B, f, C)] * (Hp - Hu))


def _augmented(model: LinearModel, *, uses_mean: bool) -> tuple[Array, Array, Array, Array]:
    """Return A, B, f, C of [x; u; mean] for increments of u."""
    (nx, nu), n = model.B.shape, model.nx + model.nu
    A, B = np.eye(n + nx * uses_mean), np.zeros((n + nx * uses_mean, nu))
    A[:nx, :nx], A[:nx, nx:n], A[:nx, n:] = model.A, model.B, np.eye(nx, nx * uses_mean)
    B[:nx], B[nx:n] = model.B, np.eye(nu)
    f, C = np.zeros(len(A)), np.zeros((model.ny, len(A)))
    f[:nx], C[:, :nx], C[:, nx:n] = model.f0, model.C, model.D
    return A, B, f, C
