"""Least-squares tracking over a horizon: the first input, by a square-root recursion.

Problem  minimise over u(0..N-1) the sum over j = 1..N of |Q_yw (C x(j) - w(j))|^2 + |Q_u u(j-1)|^2 of
         x(j+1) = A x(j) + B u(j) + f, x(0) = x.  Q_yw and Q_u are roots of weights.
Solution Stacked over the horizon this is an over-determined system in all inputs, which a QR factorisation solves.
         A recursion from the last stage to the first avoids its zeros.  The minimal cost to go is |S x(j) - s|^2 plus a
         constant.  Each stage reduces [S, s] and Q_yw [C, w(j)] to as many rows as states, inserts
         x(j) = A x + B u + f, and eliminates u from [Q_u, 0, 0; S B, S A, s - S f].  It uses Householder reflections
         only, so that condition numbers are not squared.
Unknowns The pivot rows are L^-1 u(j) = g - G x(j) with the minimum cost; with V(j) added, the cost is the minimal one
         plus |V|^2.  As functions of V the inputs and states are those of the closed loop: no power of A appears, and
         the Hessian is the identity.
Unstable An input that stays constant after the first ones leaves powers of A in S, of sizes such as 1e36 beside 1.
         Reflections with interchanges of rows and columns keep the digits of every row (Cox and Higham 1998).
Source   belda2017, (10)-(15); the order of elimination is an addition.
Cost     Linear in N: about 1200 multiplications per stage for six states, four inputs and three outputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_compiled, eliminated
from rmpc_bench.types import Array


class Path(NamedTuple):
    """The solution of every run over the horizon; NaN if the cost does not determine the inputs."""

    U: Float[Array, "runs N nu"]
    """Inputs u(0)..u(N-1)."""
    X: Float[Array, "runs N nx"]
    """States x(1)..x(N)."""
    loss: Float[Array, " runs"]
    """Minimal costs."""
    laws: Float[Array, "runs N nu columns"]
    """Rows [R, G, g] of R u(j) = g - G x(j) + V(j) of every stage; of the first one R only, as x(0) is given."""


class TrackingLaw(NamedTuple):
    """The solution as a linear function: u(0) = K_w w - K_x x + u_0, minimal cost |E_w w - E_x x + e_0|^2."""

    K_x: Float[Array, "nu nx"]
    K_w: Float[Array, "nu known"]  # gain of the desired outputs w(1)..w(N), stacked
    u_0: Float[Array, " nu"]
    E_x: Float[Array, "lost nx"]
    E_w: Float[Array, "lost known"]
    e_0: Float[Array, " lost"]


class Stage(NamedTuple):
    """An input as a function of state, known part and an unknown V: u = K_w [w; 1] - K_x x + L V."""

    K_x: Float[Array, "nu nx"]
    K_w: Float[Array, "nu known"]
    L: Float[Array, "nu nu"]


class Problem(NamedTuple):
    """A tracking problem of a model, mostly a constant one, whose inputs act at the first ``moves`` samples only."""

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    f: Float[Array, " nx"]
    C: Float[Array, "ny nx"]
    Q_yw: Float[Array, "ny ny"]
    Q_u: Float[Array, "nu nu"]
    N: int
    moves: int
    over: Sequence[tuple[Array, Array, Array, Array]] | None = None
    """A, B, f of the step to every sample 1..N, and C there, of a model that changes; those above if not given."""
    D: Float[Array, "ny nu"] | None = None
    """The outputs are C x(j) + D u(j), with u = 0 after the first ``moves``; None for 0."""

    def step(self, j: int) -> tuple[Array, Array, Array, Array]:
        """Return A, B, f of the step to sample j, and C there."""
        return (self.A, self.B, self.f, self.C) if self.over is None else self.over[j - 1]

    def stages(self) -> tuple[list[Stage], Float[Array, "lost columns"]]:
        """Return the inputs, first one first, and the rows [E_x, e] of the minimal cost |e - E_x x|^2.

        A ValueError says that the cost does not determine the inputs.
        """
        (nx, nu), ny = self.B.shape, len(self.C)
        known = self.N * ny + 1
        S, lost, found = np.zeros((0, nx + known)), [], []
        every = range(1, self.N + 1)
        seen = [self.Q_yw @ np.hstack([self.step(j)[3], np.eye(ny, known, (j - 1) * ny)]) for j in every]
        for j in range(self.N, 0, -1):
            acts = j <= self.moves
            A, B, f, _ = self.step(j)
            if self.D is None or j >= self.moves:
                S = np.vstack([S, seen[j - 1]])
            if len(S) > nx:
                S = eliminated(S, nx)[0]
                lost.append(S[nx:])
                S = S[:nx]
            of_x = S[:, :nx]
            S = np.hstack([of_x @ A, S[:, nx:]])
            S[:, -1] -= of_x @ f
            if acts:
                of_u = of_x @ B
                if self.D is not None and j > 1:  # The output at j - 1 depends on this input, too.
                    of_u, S = np.vstack([of_u, self.Q_yw @ self.D]), np.vstack([S, seen[j - 2]])
                stack = np.block([[of_u, S], [self.Q_u, np.zeros((nu, nx + known))]])
                T, order = eliminated(stack, nu, np.abs(stack[:, :nu]).max(axis=1))
                row = np.empty((nu, nu + nx + known))
                row[order] = np.linalg.solve(T[:nu, :nu], np.hstack([np.eye(nu), T[:nu, nu:]]))
                found.append(Stage(row[:, nu : nu + nx], row[:, nu + nx :], row[:, :nu]))
                S = T[nu:, nu:]
        return found[::-1], np.vstack([S, *lost])

    def law(self) -> TrackingLaw:
        """Solve for every state and every reference at once; a ValueError as of `stages`."""
        nx = len(self.A)
        (first, *_), E = self.stages()
        return TrackingLaw(first.K_x, first.K_w[:, :-1], first.K_w[:, -1], E[:, :nx], E[:, nx:-1], E[:, -1])

    def responses(
        self, stages: Sequence[Stage]
    ) -> tuple[Float[Array, "moves nu columns"], Float[Array, "N nx columns"]]:
        """Return inputs and states x(1)..x(N) as functions of [x(0); w; 1; V(0); ..]."""
        nx, nu = self.B.shape
        known = stages[0].K_w.shape[1]
        columns = nx + known + self.moves * nu
        X, U, x = np.empty((self.N, nx, columns)), np.empty((self.moves, nu, columns)), np.eye(nx, columns)
        for j in range(self.N):
            A, B, f, _ = self.step(j + 1)
            moved = A @ x
            if j < self.moves:
                K_x, K_w, L = stages[j]
                U[j] = -K_x @ x
                U[j, :, nx : nx + known] += K_w
                first = nx + known + j * nu
                U[j, :, first : first + nu] += L
                moved += B @ U[j]
            moved[:, nx + known - 1] += f
            X[j] = x = moved
        return U, X


class RunProblems(NamedTuple):
    """The problems of many runs with constant models, all inputs free; A, B and Q_yw are of every run, or one for all.

    Inputs are NaN if the cost does not determine them.
    """

    A: Float[Array, "models nx nx"]
    B: Float[Array, "models nx nu"]
    f: Float[Array, " nx"]
    C: Float[Array, "ny nx"]
    Q_yw: Float[Array, "weights ny ny"]
    R_u: Float[Array, "nu nu"]  # R_u' R_u = Q_u' Q_u
    w: Float[Array, "N ny"]  # at samples 1..N
    x: Float[Array, "runs nx"]

    def first_inputs(self) -> tuple[Float[Array, "runs nu"], Float[Array, " runs"]]:
        """Return the first inputs and the minimal costs."""
        from rmpc_bench.numerics.tracking_kernel import tracking_kernel

        A, B, f, C, Q_yw, R_u, w, x = map(as_compiled, self)
        u, loss = np.empty((len(x), B.shape[2])), np.empty(len(x))
        tracking_kernel(A, B, f, C, Q_yw, R_u, w, x, u, loss)
        return u, loss

    def paths(self) -> Path:
        """Return all inputs and the states that they lead to."""
        from rmpc_bench.numerics.tracking_kernel import path_kernel

        A, B, f, C, Q_yw, R_u, w, x = map(as_compiled, self)
        n_runs, N, (nx, nu) = len(x), len(w), B.shape[1:]
        laws = np.empty((n_runs, N, nu, nu + nx + 1))
        path = Path(np.empty((n_runs, N, nu)), np.empty((n_runs, N, nx)), np.empty(n_runs), laws)
        path_kernel(A, B, f, C, Q_yw, R_u, w, x, *path)
        return path


def moved_by(
    laws: Float[Array, "N nu columns"], A: Float[Array, "nx nx"], B: Float[Array, "nx nu"]
) -> tuple[Float[Array, "N nu unknowns"], Float[Array, "N nx unknowns"]]:
    """Return how the unknowns V(0..N-1) move inputs and states of one run with the rows `laws` of its path."""
    (N, nu, _), nx = laws.shape, len(A)
    U, X, x = np.zeros((N, nu, N * nu)), np.empty((N, nx, N * nu)), np.zeros((nx, N * nu))
    inverse = np.linalg.inv(laws[:, :, :nu])
    for j in range(N):
        if j > 0:
            U[j] = -(inverse[j] @ laws[j, :, nu : nu + nx]) @ x
        U[j, :, j * nu : (j + 1) * nu] += inverse[j]
        X[j] = x = A @ x + B @ U[j]
    return U, X
