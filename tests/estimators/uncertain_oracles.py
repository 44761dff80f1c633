"""Uncertain systems, and what a predictor does on them: conditional covariances, exact moments, Lemma 1."""

import itertools

import numpy as np
from conftest import random_psd

from rmpc_bench.models.uncertain_linear import design as uncertain_model

X0, P0 = np.array([2.0, 1.0]), 0.1 * np.eye(2)
"""Start of the benchmark."""


def benchmark(n_steps=1500, rho=1.0, **changed):
    """souto2011, section 5, (84), with all uncertainty times rho."""
    given = {
        "A": [[0, -0.5], [1, 1]], "Bw": [[-6], [1]], "C": [[-100, 10]],
        "H_A": [[0], [10 * rho]], "H_C": [[50 * rho]], "G_x": [[0.1, 0.03]],
        "H_Bw": [[0], [10 * rho]], "G_w": [[0.01]], "H_Dv": [[100 * rho]], "G_v": [[1]],
        "W": 0.1, "V": 2.0, "wbar": 0.1, "vbar": 0.9,
    }  # fmt: skip
    return uncertain_model(n_steps, **given | changed)


def random_uncertain(rng, n_steps=8, nx=3, ny=2, *, size=0.2, radius=0.5, varying=False, certain=False, nu=1):
    """Random system with every matrix nonzero: channels correlated, F of 2 x 2, 1 x 2 and 2 x 1."""
    steps = n_steps + 1 if varying else 1

    def some(*shape):
        return rng.standard_normal((steps, *shape))

    A = some(nx, nx)
    A *= radius / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    h = 0.0 if certain else size
    given = {
        "A": A, "B": some(nx, nu), "Bw": some(nx, 2), "Bv": 0.3 * some(nx, 2), "C": some(ny, nx),
        "Dw": 0.3 * some(ny, 2), "Dv": some(ny, 2),
        "H_A": h * some(nx, 2), "H_C": h * some(ny, 2), "G_x": size * some(2, nx),
        "H_Bw": h * some(nx, 1), "H_Dw": h * some(ny, 1), "G_w": some(2, 2),
        "H_Bv": h * some(nx, 2), "H_Dv": h * some(ny, 2), "G_v": some(1, 2),
        "W": random_psd(rng, 2).tolist(), "V": random_psd(rng, 2).tolist(),
        "wbar": rng.standard_normal(2).tolist(), "vbar": rng.standard_normal(2).tolist(),
    }  # fmt: skip
    return uncertain_model(n_steps, **given)


def at(schedule, k):
    """Entry k of a schedule; a constant one has length 1."""
    return schedule[k] if len(schedule) > 1 else schedule[0]


def widened(P, G, a):
    """P + P G' (a I - G P G')^-1 G P."""
    return P + P @ G.T @ np.linalg.solve(a * np.eye(len(G)) - G @ P @ G.T, G @ P)


def lemma_1(m, W, V, P, Phi, K, a_x, a_w, a_v):
    """Lemma 1, (46), for [x; x_pred], with the matrices (45) spelt out; P is 2n x 2n."""
    n, r = len(m.A), m.G_x.shape[0]
    A = np.block([[m.A, np.zeros((n, n))], [K @ m.C, Phi - K @ m.C]])
    B, D = np.vstack([m.Bw, K @ m.Dw]), np.vstack([m.Bv, K @ m.Dv])
    H_x, H_w, H_v = (np.vstack([H, K @ H_out]) for H, H_out in ((m.H_A, m.H_C), (m.H_Bw, m.H_Dw), (m.H_Bv, m.H_Dv)))
    G = np.hstack([m.G_x, np.zeros((r, n))])
    total = A @ widened(P, G, a_x) @ A.T + B @ widened(W, m.G_w, a_w) @ B.T + D @ widened(V, m.G_v, a_v) @ D.T
    return total + a_x * H_x @ H_x.T + a_w * H_w @ H_w.T + a_v * H_v @ H_v.T


def of_error(P):
    """[I -I] P [I -I]', (65)."""
    n = len(P) // 2
    return P[:n, :n] - P[:n, n:] - P[n:, :n] + P[n:, n:]


def conditional(m, W, V, S, Phi, K, F):
    """Covariance of [x; x_pred] at k+1, S at k, given F = (F_x, F_w, F_v)."""
    n = len(m.A)
    F_x, F_w, F_v = F
    A, C = m.A + m.H_A @ F_x @ m.G_x, m.C + m.H_C @ F_x @ m.G_x
    Bw, Dw = m.Bw + m.H_Bw @ F_w @ m.G_w, m.Dw + m.H_Dw @ F_w @ m.G_w
    Bv, Dv = m.Bv + m.H_Bv @ F_v @ m.G_v, m.Dv + m.H_Dv @ F_v @ m.G_v
    T = np.block([[A, np.zeros((n, n))], [K @ C, Phi - K @ m.C]])
    N_w, N_v = np.vstack([Bw, K @ Dw]), np.vstack([Bv, K @ Dv])
    return T @ S @ T.T + N_w @ W @ N_w.T + N_v @ V @ N_v.T


def start(P):
    """Covariance of [x; x_pred] at k = 0."""
    return np.block([[P, np.zeros_like(P)], [np.zeros_like(P), np.zeros_like(P)]])


def ratio(true, bound):
    """Largest generalised eigenvalue of a covariance over its bound."""
    root = np.linalg.cholesky(bound)
    return np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, true).T))[-1]


def random_F(rng, m, kind):
    """Admissible F: on the boundary at random, or anywhere inside."""
    found = []
    for H, G in ((m.H_A, m.G_x), (m.H_Bw, m.G_w), (m.H_Bv, m.G_v)):
        F = rng.standard_normal((H.shape[1], G.shape[0]))
        U, s, Vt = np.linalg.svd(F, full_matrices=False)
        sizes = np.ones_like(s) if kind == "bang" else rng.uniform(0, 1, s.shape)
        found.append(U * sizes @ Vt)
    return found


def worst_ratio(model, design, n_steps, choose):
    """Largest ratio of the true covariance, given F, over P; choose(candidate F -> ratio at k+1) picks F at k."""
    S, worst = start(design.P[0]), 0.0
    for k in range(n_steps):
        m = model.system.at(k)
        Phi, K, bound = at(design.F, k), at(design.K, k), design.P[k + 1]
        S = choose(m, lambda F, m=m, S=S, Phi=Phi, K=K: conditional(m, model.W, model.V, S, Phi, K, F), bound)
        worst = max(worst, ratio(of_error(S), bound))
    return worst


def at_random(rng, kind):
    """Choose F blindly."""
    return lambda m, move, bound: move(random_F(rng, m, kind))


def signs(m):
    """All corners of the F of scalar channels, or 12 random F on the boundary and their mirror images."""
    if all(min(H.shape[1], len(G)) == 1 for H, G in ((m.H_A, m.G_x), (m.H_Bw, m.G_w), (m.H_Bv, m.G_v))):
        return [[s * np.ones((1, 1)) for s in three] for three in itertools.product((1.0, -1.0), repeat=3)]
    tried = [random_F(np.random.default_rng(i), m, "bang") for i in range(12)]
    return tried + [[-F for F in each] for each in tried]


def worst_of_an_adversary(model, design, n_steps, sweeps=20):
    """Largest ratio, and trace at the end, under a bang-bang F that makes the error at n_steps as large as it can.

    Coordinate ascent: what is to be largest is linear in every S(k), so that a sweep backwards, with the weights of
    what follows, finds the best F at each k given all the others; for the trace, for each state, and from there for
    the ratio to P.
    """
    nx = len(design.x0)
    last = np.hstack([np.eye(nx), -np.eye(nx)])
    worst, traces = 0.0, []
    for target in (last.T @ last, *(np.outer(row, row) for row in last)):
        chosen, S = _ascend(model, design, n_steps, [None] * n_steps, target, sweeps)
        traces.append(np.trace(of_error(S[-1])))
        worst = max(worst, _largest_ratio(S, design))
        root = np.linalg.cholesky(design.P[n_steps])
        scaled = np.linalg.solve(root, np.linalg.solve(root, of_error(S[-1])).T)
        direction = last.T @ np.linalg.solve(root.T, np.linalg.eigh(scaled)[1][:, -1])
        _, S = _ascend(model, design, n_steps, chosen, np.outer(direction, direction), sweeps)
        worst = max(worst, _largest_ratio(S, design))
    return worst, max(traces)


def _largest_ratio(S, design):
    return max(ratio(of_error(now), bound) for now, bound in zip(S[1:], design.P[1:], strict=False))


def _ascend(model, design, n_steps, chosen, target, sweeps):
    """Choose F so that the sum of target * S(n_steps) is largest; return them and all S."""
    m, (W, V), nx = model.system.at(0), (model.W, model.V), len(design.x0)
    candidates, best = signs(m), 0.0
    chosen = [candidates[0] if F is None else F for F in chosen]
    for _ in range(sweeps):
        S = [start(design.P[0])]
        for k, F in enumerate(chosen):
            S.append(conditional(m, W, V, S[k], at(design.F, k), design.K[k], F))
        if np.sum(target * S[-1]) <= best * (1 + 1e-9):
            break
        best, weight = np.sum(target * S[-1]), target
        for k in reversed(range(n_steps)):
            Phi, K = at(design.F, k), design.K[k]
            moved = [np.sum(weight * conditional(m, W, V, S[k], Phi, K, F)) for F in candidates]
            chosen[k] = candidates[int(np.argmax(moved))]
            F_x = chosen[k][0]
            A, C = m.A + m.H_A @ F_x @ m.G_x, m.C + m.H_C @ F_x @ m.G_x
            T = np.block([[A, np.zeros((nx, nx))], [K @ C, Phi - K @ m.C]])
            weight = T.T @ weight @ T
    return chosen, S


def ensemble(model, design, n_steps, low=-1.0, high=1.0):
    """Exact mean and covariance of the error x_pred - x at k = 0..n_steps under white uniform diagonal F.

    Written for q = [x; x_pred; 1; w; v] and the maps L_i that one entry of one F adds to its map: nothing is shared
    with the package.
    """
    n, mean, variance = len(design.x0), 0.5 * (low + high), (high - low) ** 2 / 12
    z = np.concatenate([design.x0, design.x0, [1.0]])
    Z = np.zeros((2 * n + 1, 2 * n + 1))
    Z[:n, :n] = at(design.P, 0)
    Z += np.outer(z, z)
    noise = np.concatenate([model.wbar, model.vbar])
    joint = np.block([[model.W, model.S], [model.S.T, model.V]]) + np.outer(noise, noise)
    T = np.hstack([-np.eye(n), np.eye(n), np.zeros((n, 1))])
    means, covariances = [T @ z], [T @ Z @ T.T - np.outer(T @ z, T @ z)]
    for k in range(n_steps):
        L_0, parts = _maps(model.system.at(k), design, k)
        L_m = L_0 + mean * sum(parts, np.zeros_like(L_0))
        Q = np.block([[Z, np.outer(z, noise)], [np.outer(noise, z), joint]])
        Z = L_m @ Q @ L_m.T + variance * sum((L @ Q @ L.T for L in parts), np.zeros_like(Z))
        z = L_m @ np.concatenate([z, noise])
        means.append(T @ z)
        covariances.append(T @ Z @ T.T - np.outer(T @ z, T @ z))
    return np.array(means), np.array(covariances)


def _maps(m, design, k):
    """Map of [x; x_pred; 1; w; v] to [x; x_pred; 1] at k+1 with all F = 0, and what each diagonal entry adds."""
    shapes = [(H.shape[1], len(G)) for H, G in ((m.H_A, m.G_x), (m.H_Bw, m.G_w), (m.H_Bv, m.G_v))]
    zero = [np.zeros(shape) for shape in shapes]
    L_0, parts = _map(m, design, k, zero), []
    for channel, shape in enumerate(shapes):
        for i in range(min(shape)):
            F = [part.copy() for part in zero]
            F[channel][i, i] = 1.0
            parts.append(_map(m, design, k, F) - L_0)
    return L_0, parts


def _map(m, design, k, F):
    n, nw, nv = len(m.A), len(m.Bw.T), len(m.Bv.T)
    x, x_pred, one, w, v = np.split(np.eye(2 * n + 1 + nw + nv), np.cumsum([n, n, 1, nw]))
    x_next = (m.A + m.H_A @ F[0] @ m.G_x) @ x + (m.Bw + m.H_Bw @ F[1] @ m.G_w) @ w
    x_next = x_next + (m.Bv + m.H_Bv @ F[2] @ m.G_v) @ v
    y = (m.C + m.H_C @ F[0] @ m.G_x) @ x + (m.Dw + m.H_Dw @ F[1] @ m.G_w) @ w
    y = y + (m.Dv + m.H_Dv @ F[2] @ m.G_v) @ v
    d = 0.0 if design.d is None else at(design.d, k)[:, None] * one
    f = 0.0 if design.f is None else at(design.f, k)[:, None] * one
    e = y - at(design.C, k) @ x_pred - d
    return np.vstack([x_next, at(design.F, k) @ x_pred + f + at(design.K, k) @ e, one])
