"""Plain twins of the uncertain linear system: (24), (25) run by run in loops, moments by Kronecker products."""

import itertools

import numpy as np

NAMES = ("x", "w", "v")
TOP = {"x": ("A", "H_A"), "w": ("Bw", "H_Bw"), "v": ("Bv", "H_Bv")}
BOTTOM = {"x": ("C", "H_C"), "w": ("Dw", "H_Dw"), "v": ("Dv", "H_Dv")}
SIZES = (
    {"nx": 1, "nu": 1, "ny": 1, "nw": 1, "nv": 1, "x": (1, 1), "w": (1, 1), "v": (1, 1)},
    {"nx": 2, "nu": 1, "ny": 1, "nw": 2, "nv": 1, "x": (1, 1), "w": (1, 2), "v": (2, 1)},
    {"nx": 3, "nu": 2, "ny": 2, "nw": 1, "nv": 3, "x": (2, 3), "w": (3, 1), "v": (1, 2)},
    {"nx": 4, "nu": 1, "ny": 3, "nw": 3, "nv": 2, "x": (3, 2), "w": (2, 2), "v": (2, 3)},
)


def random_given(rng, sizes, n_steps=0, *, h=0.5, radius=0.7):
    """All matrices of a random system as arrays (k, rows, columns); of length 1 unless n_steps is given."""
    n = dict(sizes)
    for name in NAMES:
        n[f"r{name}"], n[f"s{name}"] = n.pop(name)
    shapes = {
        "A": ("nx", "nx"), "B": ("nx", "nu"), "Bw": ("nx", "nw"), "Bv": ("nx", "nv"),
        "C": ("ny", "nx"), "Dw": ("ny", "nw"), "Dv": ("ny", "nv"),
        "H_A": ("nx", "rx"), "H_C": ("ny", "rx"), "G_x": ("sx", "nx"),
        "H_Bw": ("nx", "rw"), "H_Dw": ("ny", "rw"), "G_w": ("sw", "nw"),
        "H_Bv": ("nx", "rv"), "H_Dv": ("ny", "rv"), "G_v": ("sv", "nv"),
    }  # fmt: skip
    given = {name: rng.standard_normal((n_steps + 1, n[r], n[c])) for name, (r, c) in shapes.items()}
    given["A"] *= radius / np.abs(np.linalg.eigvals(given["A"])).max(axis=1)[:, None, None]
    return {name: h * M if name[:2] == "H_" else M for name, M in given.items()}


def at(given, k):
    """The matrices at k."""
    return {name: M[k] if len(M) > 1 else M[0] for name, M in given.items()}


def true_matrices(m, F):
    """[A Bw Bv; C Dw Dv] with H F G added, (34)-(36); F has the keys x, w, v."""
    rows = [[m[place[c][0]] + m[place[c][1]] @ F[c] @ m[f"G_{c}"] for c in NAMES] for place in (TOP, BOTTOM)]
    return np.block(rows)


def walk(given, F, x, u, w, v):
    """States k = 0..N+1 and outputs k = 0..N of one run, (24) and (25) by loops over every index."""
    xs, ys = [x], []
    for k in range(len(w)):
        m = at(given, k)
        nx = len(m["A"])
        T = true_matrices(m, {c: F[c][k] for c in NAMES})
        q = [*xs[-1], *w[k], *v[k]]
        z = [sum(T[i, j] * q[j] for j in range(len(q))) for i in range(len(T))]
        xs.append(np.array([z[i] + sum(m["B"][i, j] * u[k][j] for j in range(len(u[k]))) for i in range(nx)]))
        ys.append(np.array(z[nx:]))
    return np.array(xs), np.array(ys)


def random_contraction(rng, r, s, norm=1.0):
    """Random F with singular values between 0 and a norm, one of them at it."""
    U, lam, Vt = np.linalg.svd(rng.standard_normal((r, s)), full_matrices=False)
    lam = norm * rng.uniform(0, 1, len(lam))
    lam[0] = norm
    return U * lam @ Vt


def entry_maps(m, shapes):
    """[A Bw Bv; C Dw Dv] without uncertainty, and what the diagonal entries of every F add to it."""
    zero = {c: np.zeros(shapes[c]) for c in NAMES}
    base, maps = true_matrices(m, zero), {c: [] for c in NAMES}
    for c in NAMES:
        for i in range(min(shapes[c])):
            one = {**zero, c: np.zeros(shapes[c])}
            one[c][i, i] = 1.0
            maps[c].append(true_matrices(m, one) - base)
    return base, maps


def kron_moments(given, shapes, law, schedule, start, noise, n_steps):
    """Mean and covariance of (x, x_hat) at k = 0..N by the second moment of [x; x_pred; 1], vec and Kronecker products.

    ``law`` maps a channel to mean and variance of its entries at k, ``start`` and ``noise`` are (mean, covariance) of
    x(0) and of [w; v]; ``schedule`` has F, C, K, L, f, d and x0.
    """
    (x, X), (n_bar, U) = start, noise
    nx, nn, n_hat = len(x), len(n_bar), len(schedule.x0)
    z = np.concatenate([x, schedule.x0, [1.0]])
    Z = np.outer(z, z)
    Z[:nx, :nx] += X
    means, covs = [], []
    for k in range(n_steps + 1):
        base, maps = entry_maps(at(given, k), shapes)
        q = np.concatenate([z, n_bar])
        Q = np.block([[Z, np.outer(z, n_bar)], [np.outer(n_bar, z), U + np.outer(n_bar, n_bar)]])
        s = {c: pick(getattr(schedule, c), k) for c in "FCKLfd" if getattr(schedule, c) is not None}
        f, d = s.get("f", np.zeros(n_hat)), s.get("d", np.zeros(len(s["C"])))

        def whole(T, gain, stays, constant, moves, C=s["C"], d=d):
            """Map [x; x_pred; 1; n] to [x or x(k+1); x_hat or x_pred(k+1); 1]; T maps [x; n] to [x(k+1); y(k)]."""
            top = np.hstack([T[:nx, :nx], np.zeros((nx, n_hat + 1)), T[:nx, nx:]])
            if not moves:
                top = np.hstack([np.eye(nx), np.zeros((nx, n_hat + 1 + nn))])
            y = np.hstack([T[nx:, :nx], np.zeros((len(C), n_hat + 1)), T[nx:, nx:]])
            own = np.hstack([np.zeros((n_hat, nx)), stays, constant[:, None], np.zeros((n_hat, nn))])
            told = np.hstack([np.zeros((len(C), nx)), C, d[:, None], np.zeros((len(C), nn))])
            one = np.eye(1, nx + n_hat + 1 + nn, nx + n_hat)
            return np.vstack([top, own + gain @ (y - told), one])

        def pushed(gain, stays, constant, moves, base=base, maps=maps, q=q, Q=Q, k=k, whole=whole):
            zero = whole(np.zeros_like(base), gain, stays, constant, moves)
            mean = whole(base, gain, stays, constant, moves)
            lifted = np.zeros((len(zero) ** 2, zero.shape[1] ** 2))
            for c in NAMES:
                average, variance = law(c, k)
                for T in maps[c]:
                    part = whole(T, gain, stays, constant, moves) - zero
                    mean = mean + average * part
                    lifted += variance * np.kron(part, part)
            lifted += np.kron(mean, mean)
            return mean @ q, (lifted @ Q.reshape(-1)).reshape(len(zero), len(zero))

        r, R = pushed(s["L"], np.eye(n_hat), np.zeros(n_hat), False)
        means.append(r[:-1])
        covs.append((R - np.outer(r, r))[:-1, :-1])
        z, Z = pushed(s["K"], s["F"], f, True)
    return np.array(means), np.array(covs)


def pick(M, k):
    """Entry k of a schedule; a constant one has length 1."""
    return M[k] if len(M) > 1 else M[0]


def corners(n):
    """All sign sequences of a length."""
    return itertools.product((1.0, -1.0), repeat=n)
