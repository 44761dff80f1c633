"""Every registered metric passes the checks of rmpc_bench.conformance."""

import numpy as np
import pytest
from conftest import random_psd

from rmpc_bench import registry
from rmpc_bench.conformance import MetricExample, check_component
from rmpc_bench.types import Controller, MetricLayout, Plant, Record

KINDS = registry.names("metrics")
WINDOW = {"from_": 3.0, "to": 6.0}
PARAMETERS = {
    "mse": [{}, {"of": "state", "to": "N"}, {"of": "estimate"}],
    "mae": [{}, WINDOW],
    "rmse": [{}],
    "iae": [{}, WINDOW],
    "input_power": [{}, WINDOW],
    "input_roughness": [{}],
    "settling_time": [{}, {"band": 3.0}],
    "steady_state_error": [{}, {"share": 0.4}],
    "estimation_mse": [{}],
    "nees": [{}],
    "coverage": [{}, {"of": "x.1", "level": 0.5, **WINDOW}],
    "crps": [{"of": "x.2"}],
    "log_score": [{}],
    "nis": [{}],
    "innovation_mse": [{}, WINDOW],
    "whiteness": [{}, {"lags": 3}],
    "sample": [{"of": of} for of in ("x.1", "x_hat.0", "e.2", "y.1")] + [{"of": "u.0", "at": 4.0}],
    "inside": [{"of": of} for of in (None, "set", "gaussian", "sum")],
    "cost": [{"Q_x": [3.0, 0.1, 1.0], "R_u": 0.7}],
    "certificate": [{"at": 2.0}, {"at": 2.0, "of": "worst"}, {"at": 2.0, "noise": "shared"}],
    "tracking": [{}, {"during": "bursts", "smooth": 1.0}, {"norm": "bias", "only": [1], "during": "quiet"}],
    "departures": [{"size": 1.0}],
    "input_variation": [{}, {"during": "bursts"}],
    "input_rms": [{}],
    "input_peak": [{}],
    "reported": [{"of": "gain"}, {"of": "gain", "reduce": "last", "component": 1}],
    "fallbacks": [{}],
    "near_singular": [{"below": 0.8}],
    "violation": [
        {"of": "u", "limit": 1.0},
        {"of": "x.1", "limit": (-1.0, 2.0), "what": "largest"},
        {"of": "twist", "limit": 1.0, "what": "integral", "between": 2},
        {"of": "y", "limit": 1.0, "between": 1},
    ],
    "largest": [{"of": "u.1"}, {"of": "twist"}, {"of": "y.2", "between": 2}],
    "runaway": [{"factor": 3.0}, {"beyond": 2.0, "only": [1]}],
    "qp_share": [{"of": "skipped"}, {"of": "failed"}],
}
"""Keys that make a metric of each kind; a new kind gets a line here."""
CASES = [(kind, keys, per_run) for kind in KINDS for keys in PARAMETERS.get(kind, []) for per_run in (False, True)]
RUNS, STEPS = 11, 130  # 130 samples of three states make NumPy's sums pairwise


GAINS = np.linspace(1.0, 3.0, RUNS)
"""What the plant has drawn for every run."""


class Mechanism(Plant):
    """Three states, three outputs, a manipulability that is the size of the first output, and a twist."""

    nx, nu, ny = 3, 2, 3
    Ts = 0.5
    has_singular_poses = True

    extra_signals = {"twist": "N m"}
    has_between = True

    def manipulability(self, y):
        return np.abs(y[:, 0])

    def output(self, k, delta, x, v):
        return (1.0 + k) * x + v

    def extra_signal(self, name, delta, x):
        return delta[:, None] * (x[:, :, 0] - x[:, :, 1])

    def between(self, delta, x, u, parts, first=0):
        share = (1.0 + np.arange(parts)) / parts
        return x[:, :, None] + share[:, None] * delta[:, None, None, None] * u[:, :, None, :1]


class Certifying(Controller):
    """A certificate that depends on the estimate."""

    certifies = True

    def certificate(self, k, x_hat, starts, *, shared=False):
        rho = 1.0 + x_hat[:, 0] ** 2
        return rho, 0.9 * rho


def record(*, per_run):
    """Trajectories with everything that a metric may read; P and M shared, or one per run."""
    rng = np.random.default_rng(21)
    x, x_hat, y = rng.standard_normal((3, RUNS, STEPS + 1, 3))
    u, r = rng.standard_normal((RUNS, STEPS, 2)), 0.1 * rng.standard_normal((STEPS + 1, 3))
    count = RUNS * (STEPS + 1) if per_run else STEPS + 1
    shape = (RUNS, STEPS + 1, 3, 3) if per_run else (STEPS + 1, 3, 3)
    P, M = (np.stack([random_psd(rng, 3) for _ in range(count)]).reshape(shape) for _ in range(2))
    info = {"gain": rng.standard_normal((RUNS, STEPS, 2)), "fallback": 1.0 * (rng.random((RUNS, STEPS + 1, 1)) < 0.2)}
    bursts = rng.random((RUNS, STEPS + 1)) < 0.3
    S = np.stack([random_psd(rng, 2) for _ in range(RUNS * (STEPS + 1))]).reshape(RUNS, STEPS + 1, 4)
    info |= {"e": rng.standard_normal((RUNS, STEPS + 1, 2)), "S": S, "qp": rng.integers(0, 5, (RUNS, STEPS, 1)) * 1.0}
    layout = MetricLayout(STEPS, 0.5, "m", "V", plant=Mechanism(), bursts=True)
    return Record(0.5, x, y, x_hat, u, r, P, M, Certifying(), info, bursts, layout)


@pytest.fixture(scope="module")
def examples():
    """Return the trajectories by whether P and M belong to a run."""
    return {per_run: MetricExample(record(per_run=per_run), lambda rows: GAINS[rows]) for per_run in (False, True)}


def test_every_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


@pytest.mark.parametrize(("kind", "keys", "per_run"), CASES)
def test_conformance(kind, keys, per_run, examples):
    """Oracle: the rules of a metric."""
    results = check_component(registry.get("metrics", kind)(**keys), examples[per_run])
    assert [str(result) for result in results if result.status == "failed"] == []
