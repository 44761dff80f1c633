"""An experiment of two states in which every component can be replaced by one written for one run."""

import numpy as np

from rmpc_bench.components.single_run import design_function, single_run
from rmpc_bench.config_file import factories
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.noise.gaussian import Gaussian
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.simulation.recording import Recording
from rmpc_bench.simulation.reference import constant
from rmpc_bench.simulation.scenario import Experiment, Scenario
from rmpc_bench.types import Method, Plant, PlantInfo
from rmpc_bench.types.contract import checked

N, TS = 12, 0.5
MODEL = LinearModel([[1.0, 0.1], [-0.2, 0.9]], [[0.0], [0.3]], [[1.0, 0.0]], 0.04 * np.eye(2), [[0.25]])
START = {"x0": np.array([0.5, -0.5]), "P0": np.eye(2)}


class TwoStates(Plant):
    """The model itself, with noise on both states and on the output."""

    nx, nu, ny, Ts = 2, 1, 1, TS

    def draw(self, parameters, rngs, n_steps):
        """Nothing is uncertain."""
        return ()

    def step(self, k, delta, x, u, w):
        """Move."""
        return np.einsum("ij,rj->ri", MODEL.A, x) + np.einsum("ij,rj->ri", MODEL.B, u) + w

    def output(self, k, delta, x, v):
        """Measure the first state."""
        return x[:, :1] + v


@single_run
class Textbook:
    """A Kalman filter as in a textbook."""

    def __init__(self, model):
        self.m = model.at(0)

    def start(self, x0, P0):
        """Keep the first prediction."""
        self.x, self.P = x0, P0

    def update(self, y, u_previous):
        """Predict with u(k-1), correct with y(k)."""
        m = self.m
        if u_previous is not None:
            self.x = m.A @ self.x + m.B @ u_previous
            self.P = m.A @ self.P @ m.A.T + m.Q_w
        L = self.P @ m.C.T @ np.linalg.inv(m.C @ self.P @ m.C.T + m.R_v)
        self.x = self.x + L @ (y - m.C @ self.x)
        I_LC = np.eye(len(self.x)) - L @ m.C
        self.P = I_LC @ self.P @ I_LC.T + L @ m.R_v @ L.T
        return self.x, self.P


class Fixed:
    """An estimator that returns x0, as a base for those that do something else at one sample."""

    def start(self, x0):
        """Keep it."""
        self.x = x0

    def update(self, y, k, run):
        """Return it."""
        return self.x


def given(group, **more):
    """What the bench provides to the design functions of a group."""
    info = PlantInfo.of(more.pop("plant", None) or TwoStates())
    common = {"n_steps": N, "Ts": TS, "plant_info": info}
    return {
        "estimators": {**common, "model": MODEL, **START, "plant": TwoStates()},
        "controllers": {**common, "model": MODEL},
        "plants": {"n_steps": N, "Ts": TS},
        "metrics": {},
    }[group]


def designed(group, component, **keys):
    """Call the design function of a component with what the bench provides."""
    import inspect

    function = design_function(group, component)
    taken = inspect.signature(function).parameters
    provided = {name: value for name, value in given(group).items() if name in taken}
    made = function(**provided, **keys)
    return checked(group, "mine", made, provided)


def kalman():
    """Return the filter of the bench."""
    return factories.estimator("kalman", MODEL, n_steps=N, **START)


def experiment(estimator=None, controller=None, plant=None, metrics=(), n_runs=6, record=("x", "y", "u", "x_hat")):
    """Return an experiment of one method; what is not given is a component of the bench."""
    plant = plant or TwoStates()
    zero = np.zeros
    scenario = Scenario(
        seed=7,
        uncertainty={},
        parameters={},
        x0=np.array([1.0, 0.0]),
        x0_noise=(Gaussian(zero(2), np.eye(2)),),
        process=(Gaussian(zero(plant.nw), 0.2 * np.eye(plant.nw)),) if plant.nw else (),
        measurement=(Gaussian(zero(1), 0.5 * np.eye(1)),),
        reference=constant(1, value=1.0),
    )
    method = Method("mine", estimator or kalman(), controller or Rest(1))
    return Experiment(plant, (method,), scenario, tuple(metrics), n_runs, N, recording=Recording(record, n_runs))


def simulated(made, block=None):
    """Simulate all runs in blocks and return status, metrics, trajectories and the journals of the blocks."""
    block = block or made.n_runs
    ranges = [range(i, min(i + block, made.n_runs)) for i in range(0, made.n_runs, block)]
    blocks = [simulate_block(made, made.methods[0], runs) for runs in ranges]
    traces = {name: np.concatenate([each.traces[name] for each in blocks]) for name in blocks[0].traces}
    status = np.concatenate([each.status for each in blocks])
    metrics = np.concatenate([each.metrics for each in blocks], axis=1)
    return status, metrics, traces, [each.journal for each in blocks]
