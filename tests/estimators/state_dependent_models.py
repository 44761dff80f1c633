"""Small state-dependent models: one whose matrices are the same at every state, and a mass with friction."""

import numpy as np

from rmpc_bench.models.state_dependent import Pair, StateDependentModel


class Base(StateDependentModel):
    """What a state-dependent model has beside its pairs."""

    largest = 20.0

    def __init__(self, C, Q_w, R_v, nu):
        self.C, self.Q_w, self.R_v, self.nu = C, Q_w, R_v, nu
        self.ny, self.nx = C.shape


class Frozen(Base):
    """The pair of a linear model, at every state."""

    def __init__(self, model):
        super().__init__(model.C, model.Q_w, model.R_v, model.nu)
        self.pair = model.A, model.B

    def at_state(self, x):
        return Pair(*(np.broadcast_to(matrix, (len(x), *matrix.shape)) for matrix in self.pair))


class Mass(Base):
    """A mass moved by a force, with friction that grows with the speed: x = [p, v], y = p, Ts = 0.1 s."""

    Ts = 0.1

    def __init__(self):
        super().__init__(np.array([[1.0, 0.0]]), np.diag([1e-6, 1e-4]), np.array([[1e-2]]), 1)

    def at_state(self, x):
        A, B = np.tile(np.eye(2), (len(x), 1, 1)), np.zeros((len(x), 2, 1))
        A[:, 0, 1], A[:, 1, 1] = self.Ts, 1.0 - self.Ts * np.abs(x[:, 1])
        B[:, :, 0] = 0.5 * self.Ts**2, self.Ts
        return Pair(A, B)

    def simulated(self, rng, runs, steps, noise):
        """States (runs, samples, 2), measurements and inputs of the model itself, with uniform measurement noise."""
        x, u = [0.3 * rng.standard_normal((runs, 2))], rng.standard_normal((runs, steps + 1, 1))
        for k in range(steps):
            A, B = self.at_state(x[-1])
            x.append(np.einsum("rij,rj->ri", A, x[-1]) + np.einsum("rij,rj->ri", B, u[:, k]))
        x = np.stack(x, axis=1)
        return x, x[:, :, :1] + noise * rng.uniform(-1.0, 1.0, (runs, steps + 1, 1)), u


class Bursty(Mass):
    """The mass with a sensor whose noise is larger from k = 10 to 19."""

    def __init__(self, factor=5.0):
        super().__init__()
        self.factor = factor

    def R_v_at(self, k):
        return (self.factor**2 if 10 <= k < 20 else 1.0) * self.R_v
