"""Every registered estimator, on three small models, passes the checks of rmpc_bench.conformance."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import random_model, random_psd
from optional_libraries import skip_without_library
from required_keys import sampled

from rmpc_bench import registry
from rmpc_bench.conformance import EstimatorExample, check_component
from rmpc_bench.conformance.estimators import EstimatorInformationExample
from rmpc_bench.conformance.results import run_checks, with_expected
from rmpc_bench.conformance.systems import LinearSystem
from rmpc_bench.estimators.enhanced_robust import Margins
from rmpc_bench.estimators.lmmse import EntryLaw
from rmpc_bench.estimators.risk_sensitive import Radius
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.plants.uncertain_linear import Uncertainty
from rmpc_bench.plants.uncertain_linear import design as uncertain_plant
from rmpc_bench.types import Estimate, Estimator

KINDS = registry.names("estimators")
PARAMETERS = {
    "oracle": [{}],
    "control-lqe": [{}, {"form": "predictor"}],
    "kalman": [{}, {"noise": "matched", "use_y0": False}],
    "wasserstein-kalman": [{"radius": 0.01}, {"radius": 0.5, "form": "predictor", "use_y0": False}],
    "h-infinity": [
        {"fraction": 0.5},
        {"theta": 1e-3, "form": "predictor", "weight": 2.0},
        {"gamma": 30.0, "use_y0": False},
    ],
    "fading-kalman": [{"alpha": 1.001}, {"alpha": 1.2, "form": "predictor", "use_y0": False}],
    "directional-kalman": [{"q": 0.01, "direction": 1.0}, {"q": 2.0, "direction": 1.0, "form": "predictor"}],
    "robust-kalman": [{"c": 0.1}, {"c": 0.1, "kl": "half", "tau": 0.5}],
    "risk-sensitive": [{"theta": 0.01}, {"theta_from": Radius(c=0.01)}, {"theta": 0.01, "tau": 1.0}],
    "kalman-predictor": [{}, {"R": 2.0, "gain": "steady"}],
    "enhanced-robust": [{}, {"eps": Margins(x=0.1, w=0.2, v=0.3), "tuned": True}, {"rule": "state"}],
    "sayed-bdu": [{}, {"alpha": 0.1, "form": "predictor"}, {"lam": "search"}],
    "robust-h-infinity": [{"alpha": 0.1}, {"alpha": 0.1, "theta": 1e-3, "weight": 2.0, "eps": 1e-8}],
    "lmmse": [{}, {"law": EntryLaw(mean=0.2, variance=0.1)}, {"form": "filter"}],
    "lp-window": [{}, {"Ne": 2, "start": "anchored"}],
    "student-kalman": [{}, {"dof": 2.5, "iterations": 4, "use_y0": False}],
    "huber-kalman": [{}, {"k": 0.5, "robust": "both", "use_y0": False}, {"variant": "innovation", "eps": 0.1}],
    "correntropy-kalman": [{}, {"sigma": 2.0, "robust": "both", "use_y0": False}],
    "gated-kalman": [{}, {"gate": 50.0, "use_y0": False}, {"probability": 0.999}],
    "mixed": [{}, {"q": "lag", "use_y0": False}, {"q": "one-pass"}],
    "set-membership": [
        {},
        {"inflate": False},
        {"update": "maksarov-norton", "level": 0.9999},
        {"update": "maksarov-norton", "level": 0.9999, "criterion": "volume", "use_y0": False},
    ],
    "moving-horizon": [
        {"window": 3},
        {"window": 4, "w": (-0.5, 0.8), "x": (-40.0, None), "use_y0": False},
        {"window": 2, "w": (0.0, None), "v": (-30.0, 30.0)},
    ],
    "nonlinear-moving-horizon": [{"window": 3}, {"window": 2, "x": (-0.5, 3.0), "use_y0": False}],
    "kalman-disturbance": [{}, {"drift": 0.1, "D0": 2.0, "noise": "matched"}],
    "extended-kalman": [{}, {"spread": 1e-3, "use_y0": False}],
    "unscented-kalman": [{}, {"alpha": 0.5, "beta": 2.0, "kappa": 1.0, "use_y0": False}],
}
"""Parameters beyond the start that make a design of each kind; a new kind gets a line here."""
BOUNDED = ("kalman", "mixed", "set-membership", "kalman-disturbance")
"""Kinds that know bounded noises."""
WITHOUT_COVARIANCE = ("control-lqe", "lp-window")
"""Kinds whose design takes x0 without P0."""
SIZES = [(1, 1, 1), (3, 2, 2), (4, 1, 2)]
CASES = [(kind, parameters, size) for kind in KINDS for parameters in PARAMETERS.get(kind, []) for size in SIZES]
RUNS, STEPS = 9, 12


def test_every_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


def uncertain(rng, model):
    """Make everything uncertain; model and plant."""
    nx, ny = model.nx, model.ny
    sizes = {"H_A": (nx, 2), "H_C": (ny, 2), "G_x": (2, nx), "H_Bw": (nx, 1), "G_w": (2, nx), "H_Dv": (ny, 2),
             "G_v": (1, ny), "Bv": (nx, ny), "Dw": (ny, nx)}  # fmt: skip
    given = {name: 0.3 * rng.standard_normal((1, *shape)) for name, shape in sizes.items()}
    given |= {"A": model.A[None], "B": model.B[None], "C": model.C[None], "Bw": np.eye(nx), "Dv": np.eye(ny)}
    truth = uncertain_plant(0.1, STEPS, **given)
    return uncertain_model(STEPS, **given, W=model.Q_w.tolist(), V=model.R_v.tolist()), {"plant": truth}


def bounded(rng, model):
    """Give a model bounded noises, the process noise another one at every k."""
    M_w = np.array([(1.0 + 0.5 * np.sin(k)) * random_psd(rng, model.nx) for k in range(STEPS + 1)])
    given = {"A": model.A, "B": model.B, "C": model.C, "P_w": model.Q_w, "P_v": model.R_v}
    return mixed_model(STEPS, **given, M_w=M_w, M_v=30.0 * model.R_v, w_mean=0.3, v_mean=-0.1)


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}-{'-'.join(case[1])}-{case[2][0]}{case[2][1]}{case[2][2]}")
def case(request):
    """Return a design with the data to check it with."""
    kind, parameters, (nx, nu, ny) = request.param
    skip_without_library("estimators", kind)
    rng = np.random.default_rng(11)
    model = random_model(rng, nx, nu, ny, 0.9)
    if kind == "oracle":
        model, parameters = uncertain(rng, model)
    start = {"x0": rng.standard_normal(nx)} | ({} if kind in WITHOUT_COVARIANCE else {"P0": model.Q_w})
    if kind in BOUNDED and (kind != "kalman" or parameters):
        model, parameters = bounded(rng, model), parameters | {"M0": 40.0 * model.Q_w}
    design = registry.get("estimators", kind)(model, STEPS, **start, **sampled(kind), **parameters)
    example = EstimatorExample.random(nu, ny, n_runs=RUNS, n_steps=STEPS, delta=lambda rows: drawn(design, rows))
    return design, example, nx


def drawn(estimator, rows):
    """Uncertain matrices of some runs, for an oracle estimator."""
    shapes = [tuple(estimator.system.size(f"{axis}{channel}") for axis in "rs") for channel in "xwv"]
    return Uncertainty().draw([np.random.default_rng((9, int(row))) for row in rows], STEPS + 1, shapes)


def test_conformance(case):
    """Oracle: the rules of an estimator; x_hat has the model's states."""
    design, example, nx = case
    assert [str(result) for result in check_component(design, example) if result.status == "failed"] == []
    assert example.x_hat(design).shape == (RUNS, STEPS + 1, nx)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "oracle"])
def test_available_information(kind):
    """Every estimator uses the data up to k only, is in time and exact; failures are declared with their reason."""
    skip_without_library("estimators", kind)
    # A linear program per run and sample takes a millisecond.
    system = replace(LinearSystem.shipped(), n_runs=8 if kind == "lp-window" else 20, n_steps=100)
    start = {"x0": system.x0} | ({} if kind in WITHOUT_COVARIANCE else {"P0": system.P0})
    start |= {"M0": system.P0} if kind in ("mixed", "set-membership") else {}
    start |= sampled(kind) | PARAMETERS[kind][0]
    design = registry.get("estimators", kind)(system.model, system.n_steps, **start)
    results = run_checks(EstimatorInformationExample.checks, design, EstimatorInformationExample(system))
    failed = [str(each) for each in with_expected(results, design.expected_failures) if each.status == "failed"]
    assert failed == []


KALMAN_LIMITS = {
    "kalman": {},
    "directional-kalman": {"q": 0.0, "direction": 1.0},
    "fading-kalman": {"alpha": 1.0},
    "wasserstein-kalman": {"radius": 1e-7},
    "robust-kalman": {"c": 1e-12},
    "risk-sensitive": {"theta": 1e-9},
    "h-infinity": {"theta": 1e-9},
    "kalman-predictor": {},
    "enhanced-robust": {},
    "sayed-bdu": {},
    "robust-h-infinity": {"alpha": 1.0},
    "lmmse": {"form": "filter"},
    "student-kalman": {"dof": 1e12},
    "huber-kalman": {"k": 1e6},
    "correntropy-kalman": {"sigma": 1e9},
    "gated-kalman": {"gate": 1e12},
    "mixed": {"M0": np.zeros((2, 2))},
    "moving-horizon": {"window": 5},
    "nonlinear-moving-horizon": {"window": 5},
    "kalman-disturbance": {"D0": 0.0},
    "extended-kalman": {},
    "unscented-kalman": {},
}
"""Keys of every kind with which it is the Kalman filter of a linear model."""
WITHOUT_LIMIT = {
    "oracle": "needs a plant; tests/estimators/test_missing_measurements.py",
    "control-lqe": "the gains of the first samples differ; tests/estimators/test_missing_measurements.py",
    "lp-window": "no covariances",
    "set-membership": "sets in place of covariances",
}
TWO_FORMS = (
    "robust-kalman",
    "risk-sensitive",
    "wasserstein-kalman",
    "h-infinity",
    "sayed-bdu",
    "lmmse",
    "fading-kalman",
)
FORMS = [(kind, "") for kind in KALMAN_LIMITS] + [(kind, "predictor") for kind in TWO_FORMS]


def kalman_with_gaps(design, system):
    """Return the outcome of the check."""
    checks = [each for each in EstimatorInformationExample.checks if each.id == "kalman-with-gaps"]
    [result] = run_checks(checks, design, EstimatorInformationExample(system))
    return result


def test_every_kind_has_a_limit_or_a_reason():
    """Oracle: the registry."""
    assert sorted([*KALMAN_LIMITS, *WITHOUT_LIMIT]) == KINDS


@pytest.mark.parametrize("outputs", [1, 2])
@pytest.mark.parametrize(("kind", "form"), FORMS)
def test_the_limit_is_the_kalman_filter_with_missing_measurements(kind, form, outputs):
    """Oracle: kalman; with two outputs also samples at which one of them is missing."""
    design, system = registry.get("estimators", kind), LinearSystem.shipped()
    if outputs == 2:
        now = system.model
        system = LinearSystem.of(
            LinearModel(now.A, now.B, [[1.0, 0.0], [0.3, 1.0]], now.Q_w, [[0.1, 0.03], [0.03, 0.2]])
        )
    keys = sampled(kind) | KALMAN_LIMITS[kind] | ({"form": form} if form else {})
    result = kalman_with_gaps(design(system.model, system.n_steps, x0=system.x0, P0=system.P0, **keys), system)
    assert result.status == "passed", str(result)


def test_gains_of_a_run_without_gaps_do_not_pass():
    """The check can fail: a filter that predicts where y is missing, and keeps the gains of the other runs."""

    class Fixed(Estimator):
        def __init__(self, full):
            self.full = full

        bridges_missing = True

        def init(self, n_runs):
            return (np.tile(self.full.x0, (n_runs, 1)),)

        def correct(self, k, state, y):
            e = np.where(np.isnan(y), 0.0, y - state[0] @ self.full.C[0].T)
            x_hat = state[0] + e @ self.full.L[k].T
            return (x_hat,), Estimate(x_hat, None, None, np.zeros(len(y), dtype=np.int8), {})

        def predict(self, k, state, u):
            return (state[0] @ self.full.F[0].T + u @ self.full.B[0].T,)

    system = LinearSystem.shipped()
    result = kalman_with_gaps(Fixed(system.kalman), system)
    assert result.status == "failed" and "keep the gains of a run in which nothing is missing" in result.reason
    wide = registry.get("estimators", "robust-kalman")(system.model, system.n_steps, x0=system.x0, P0=system.P0, c=0.1)
    assert kalman_with_gaps(wide, system).status == "not checked"
