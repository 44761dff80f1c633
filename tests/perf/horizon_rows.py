"""Moving-horizon estimation: a window of ten steps of two states, noise that is not negative, a block of 50 runs.

The system is that of Rao, Rawlings and Lee (2001).  The baseline writes the program of every window anew and solves it
by quadprog, run by run, as a script would do it.
"""

import numpy as np

from perf.row import Row

BLOCK, STEPS, WINDOW = 50, 40, 10
A, C, R_V, P0 = np.array([[0.99, 0.2], [-0.1, 0.3]]), np.array([[1.0, -3.0]]), 0.01, np.eye(2)


def measurements():
    """Return the outputs of all runs, (samples, runs, 1)."""
    rng = np.random.default_rng(2001)
    x, found = np.zeros((BLOCK, 2)), []
    for _ in range(STEPS + 1):
        found.append(x @ C.T + 0.1 * rng.standard_normal((BLOCK, 1)))
        x = x @ A.T + [0.0, 1.0] * np.abs(rng.standard_normal((BLOCK, 1)))
    return found


def ours():
    """Return the last estimates of all runs."""
    from rmpc_bench.estimators.moving_horizon import design
    from rmpc_bench.models.linear import LinearModel

    model = LinearModel(A, np.zeros((2, 1)), C, [0.0, 1.0], R_V)
    made = design(model, STEPS, x0=np.zeros(2), P0=P0, window=WINDOW, w=[(None, None), (0.0, None)])
    y, u = measurements(), np.zeros((BLOCK, 1))

    def work():
        state = made.init(BLOCK)
        for k in range(STEPS):
            state, _ = made.correct(k, state, y[k])
            state = made.predict(k, state, u)
        return made.correct(STEPS, state, y[STEPS])[1].x_hat

    return work, (STEPS + 1) * BLOCK


def fit(y, x_bar, P_bar):
    """Return the last state of a window: unknowns are its first state and the noises."""
    import quadprog

    n = 1 + len(y)
    H, f = np.zeros((n, n)), np.zeros(n)
    H[:2, :2], f[:2] = np.linalg.inv(P_bar), np.linalg.solve(P_bar, x_bar)
    H[2:, 2:] = np.eye(n - 2)
    state = np.eye(2, n)
    for j, each in enumerate(y):
        if j:
            state = A @ state
            state[1, 1 + j] += 1.0
        row = (C @ state)[0]
        H += np.outer(row, row) / R_V
        f += row * each / R_V
    z = quadprog.solve_qp(H, f, np.eye(n)[:, 2:], np.zeros(n - 2))[0] if n > 2 else np.linalg.solve(H, f)
    return state @ z


def by_quadprog():
    """Return the same numbers, every window by a program of its own."""
    y = np.array(measurements())[:, :, 0]
    covariances = [P0]
    for _ in range(STEPS):
        P = covariances[-1]
        L = P @ C.T / (C @ P @ C.T + R_V)
        covariances.append(A @ (P - L @ C @ P) @ A.T + np.diag([0.0, 1.0]))

    def work():
        last = []
        for i in range(BLOCK):
            x_hat = []
            for k in range(STEPS + 1):
                first = max(k - WINDOW, 0)
                x_bar = A @ x_hat[first - 1] if first else np.zeros(2)
                x_hat.append(fit(y[first : k + 1, i], x_bar, covariances[first]))
            last.append(x_hat[-1])
        return last

    return work, (STEPS + 1) * BLOCK


ROWS = [
    Row("moving horizon, N = 10, w >= 0", "run-step", ours, by_quadprog, "quadprog, every window written anew"),
]
