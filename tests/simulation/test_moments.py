"""Exact moments against Kronecker products, simulation, published numbers and the limit of a Kalman filter."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROUND, random_psd, within_stat
from estimators.uncertain_oracles import P0, X0, benchmark
from plants.uncertain_twin import NAMES, SIZES, corners, kron_moments, random_contraction, random_given
from simulation.toy import Halfway, Proportional, Walk
from uncertain_experiment import write_estimation

from rmpc_bench import load_config
from rmpc_bench.estimators import enhanced_robust, kalman, kalman_predictor, oracle
from rmpc_bench.estimators.gain_schedule import GainScheduleFilter
from rmpc_bench.models import uncertain_linear as models
from rmpc_bench.noise.gaussian import Gaussian
from rmpc_bench.plants.uncertain_linear import Uncertainty, design
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.moments import Laws, Moments, exact_laws, exact_moments, signals
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.simulation.reference import constant
from rmpc_bench.simulation.scenario import Scenario, with_cross_covariance
from rmpc_bench.types import Channel, ConfigError, Method, Noise, Period, Plant

STEPS = 7
LAWS = {
    "uniform": Uncertainty(),
    "skewed": Uncertainty("uniform", 0.0, 1.0),
    "extremes": Uncertainty("extremes", -0.5, 1.0),
    "fixed": Uncertainty("fixed", value={"x": -1.0, "v": 0.5}),
}
SYSTEMS = pytest.mark.parametrize("sizes", SIZES, ids=lambda sizes: f"nx={sizes['nx']}")
VARIES = pytest.mark.parametrize("n_steps", [0, STEPS], ids=["constant", "varying"])
LAW = pytest.mark.parametrize("law", LAWS)
FORM = pytest.mark.parametrize("form", ["predictor", "filter"])


def random_filter(rng, nx, ny, n_steps=0, form="predictor", parts=True):
    """Random gains, no good ones; axis 0 = k of length 1 or N + 1."""
    K, L = 0.3 * rng.standard_normal((2, n_steps + 1, nx, ny))
    f, d = rng.standard_normal((n_steps + 1, nx)), rng.standard_normal((1, ny))
    return GainScheduleFilter(
        x0=rng.standard_normal(nx), F=0.3 * rng.standard_normal((n_steps + 1, nx, nx)), B=np.zeros((1, nx, 1)),
        C=0.5 * rng.standard_normal((1, ny, nx)), K=K, L=L if form == "filter" else np.zeros((1, nx, ny)),
        P=np.zeros((1, nx, nx)), f=f if parts else None, d=d if parts else None,
    )  # fmt: skip


def random_laws(rng, sizes):
    """Start and noises of a random system; w and v correlated."""
    nx, nn = sizes["nx"], sizes["nw"] + sizes["nv"]
    return Laws(rng.standard_normal(nx), random_psd(rng, nx), rng.standard_normal(nn), random_psd(rng, nn))


def by_kronecker(given, sizes, law, schedule, laws):
    """Moments by the twin."""
    entries = law if callable(law) else lambda c, k: law.entry(c)
    shapes = {c: sizes[c] for c in NAMES}
    return kron_moments(given, shapes, entries, schedule, (laws.x, laws.X), (laws.n, laws.U), STEPS)


@SYSTEMS
@VARIES
@LAW
@FORM
def test_they_are_those_of_the_lifted_recursion(sizes, n_steps, law, form, rng):
    """Oracle: vec of the second moment of [x; x_pred; 1] by Kronecker products of the maps of every entry of F."""
    given, laws = random_given(rng, sizes, n_steps), random_laws(rng, sizes)
    schedule = random_filter(rng, sizes["nx"], sizes["ny"], n_steps, form)
    ours = exact_moments(design(0.1, STEPS, **given, uncertainty=LAWS[law]), schedule.gain_schedule, laws, STEPS)
    mean, cov = by_kronecker(given, sizes, LAWS[law], schedule, laws)
    scale = np.abs(cov).max() + np.abs(mean).max() ** 2  # a covariance is what is left of a second moment
    np.testing.assert_allclose(ours.mean, mean, atol=1e-12 * scale)
    np.testing.assert_allclose(ours.cov, cov, atol=1e-12 * scale)


@FORM
def test_a_filter_may_have_fewer_states_and_no_constant_parts(form, rng):
    """Oracle: the lifted recursion; a plant of 3 states and a filter of 2."""
    sizes = SIZES[2]
    given, laws = random_given(rng, sizes), random_laws(rng, sizes)
    schedule = random_filter(rng, 2, sizes["ny"], 0, form, parts=False)
    plant = design(0.1, STEPS, **given)
    ours = exact_moments(plant, schedule.gain_schedule, laws, STEPS)
    mean, cov = by_kronecker(given, sizes, plant.uncertainty, schedule, laws)
    np.testing.assert_allclose(ours.mean, mean, atol=1e-12 * np.abs(cov).max())
    np.testing.assert_allclose(ours.cov, cov, atol=1e-12 * np.abs(cov).max())
    assert set(signals(ours, 3)) == {"mean(x)", "cov(x)", "mean(x_hat)", "cov(x_hat)"}


def test_a_given_sequence(rng):
    """Oracle: the same recursion of the plant whose matrices have the sequence of F in them, without uncertainty."""
    sizes, laws = SIZES[3], random_laws(rng, SIZES[3])
    given = random_given(rng, sizes)
    worst = tuple(np.array([random_contraction(rng, *sizes[c]) for _ in range(STEPS + 1)]) for c in NAMES)
    changed = dict(given)
    for F, c, names in zip(worst, NAMES, (("A", "C"), ("Bw", "Dw"), ("Bv", "Dv")), strict=True):
        for name in names:
            changed[name] = given[name] + given[f"H_{name}"] @ F @ given[f"G_{c}"]
    schedule = random_filter(rng, 4, 3, 0, "filter")
    ours = exact_moments(design(0.1, STEPS, **given).against(worst), schedule.gain_schedule, laws, STEPS)
    mean, cov = by_kronecker(changed, sizes, lambda c, k: (0.0, 0.0), schedule, laws)
    np.testing.assert_allclose(ours.mean, mean, atol=1e-12 * np.abs(cov).max())
    np.testing.assert_allclose(ours.cov, cov, atol=1e-12 * np.abs(cov).max())


def scenario(rng, plant, laws, nw):
    """A scenario with these laws; its cross-covariance by `with_cross_covariance`."""
    root = np.linalg.cholesky(laws.X)
    independent = Scenario(
        seed=4, uncertainty={}, parameters={}, x0=laws.x, x0_noise=(Gaussian(np.zeros(len(laws.x)), root),),
        process=(Gaussian(laws.n[:nw], np.linalg.cholesky(laws.U[:nw, :nw])),),
        measurement=(Gaussian(laws.n[nw:], np.linalg.cholesky(laws.U[nw:, nw:])),),
        reference=constant(plant.ny, value=0.0),
    )  # fmt: skip
    return with_cross_covariance(independent, laws.U[:nw, nw:], nw, len(laws.n) - nw)


@pytest.mark.parametrize(
    ("number", "n_steps", "law", "form"),
    [(0, 0, "skewed", "filter"), (1, STEPS, "uniform", "predictor"), (2, 0, "extremes", "filter"),
     (3, STEPS, "skewed", "filter"), (2, STEPS, "fixed", "predictor")],
)  # fmt: skip
def test_the_simulation_has_them(number, n_steps, law, form, rng):
    """Oracle: the real loop, 2000 runs: mean, products of deviations from the exact mean, within STAT at every k."""
    sizes = SIZES[number]
    given, laws = random_given(rng, sizes, n_steps), random_laws(rng, sizes)
    plant = design(0.1, STEPS, **given, uncertainty=LAWS[law])
    schedule = random_filter(rng, sizes["nx"], sizes["ny"], n_steps, form)
    method, some = Method("m", schedule, Rest(plant.nu)), scenario(rng, plant, laws, sizes["nw"])
    gathered = exact_laws(plant, method, some)
    assert isinstance(gathered, Laws)
    for ours, theirs in zip(gathered[:4], laws[:4], strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)
    mean, cov = exact_moments(plant, schedule.gain_schedule, gathered, STEPS)
    draws = some.draw(plant, range(2000), STEPS)
    record, status = simulate(plant, method, draws, np.zeros((STEPS + 1, plant.ny)), STEPS)
    assert not status.any()
    z = np.concatenate([record.x, record.x_hat], axis=2)
    assert within_stat(z[:, 1:], mean[1:]) and within_stat(z[:, 0, : plant.nx], mean[0, : plant.nx])
    if form == "predictor":
        np.testing.assert_array_equal(z[:, 0, plant.nx :], np.tile(mean[0, plant.nx :], (2000, 1)))
    deviation = (z - mean)[:, 1:]
    assert within_stat(deviation[..., :, None] * deviation[..., None, :], cov[1:])


@FORM
@VARIES
def test_without_uncertainty_a_kalman_filters_own_covariance_is_right(form, n_steps, rng):
    """Oracle: the filter's P at every k, and no mean error; w and v correlated in the predictor only."""
    sizes = SIZES[2]
    given = random_given(rng, sizes, n_steps, h=0.0)
    if form == "filter":  # it wants noises without correlation
        given |= {name: np.zeros_like(given[name]) for name in ("Bv", "Dw")}
    noises = {"W": [0.5], "V": [1.0, 2.0, 3.0], "wbar": [1.0], "vbar": [1.0, -1.0, 0.5]}
    model = models.design(STEPS, **given, **noises, S=[[0.1, 0.2, 0.3]] if form == "predictor" else 0.0)
    x0, X = rng.standard_normal(3), random_psd(rng, 3)
    made = (kalman_predictor if form == "predictor" else kalman).design(model, STEPS, x0=x0, P0=X)
    found = exact_moments(design(0.1, STEPS, **given), made.gain_schedule, Laws(x0, X, *model.noise), STEPS)
    named = signals(found, 3)
    np.testing.assert_allclose(named["mean(e)"], 0.0, atol=1e-11)
    np.testing.assert_allclose(named["cov(e)"], made.P, atol=1e-10)  # roots against the moments, sizes near 1


ENDS = {  # the reference study sections 2, 5; digits as printed there
    (-1.0, 1.0): {"robust": (5.579, 10.883), "classic": (323.5, 1550.9), "mean": (-0.234, 0.510), "after": (22, 33)},
    (0.0, 1.0): {"robust": (5.898, 15.264), "classic": (171.3, 812.8), "mean": (-0.062, 0.389), "after": (43, 73)},
    (-0.5, 0.5): {"after": (147, 243)},
}


@pytest.fixture(scope="module")
def published():
    """Return bound and exact error moments of both predictors of souto2011 over 1500 steps, for three laws."""
    model = benchmark()
    given = {name: np.array(M) for name, M in model.system.over_time._asdict().items()}
    robust = enhanced_robust.design(model, 1500, x0=X0, P0=P0, eps=0.1)
    classic = kalman_predictor.design(model, 1500, x0=X0, P0=P0)
    found = {}
    for bounds in ENDS:
        plant = design(1.0, 1500, **given, uncertainty=Uncertainty("uniform", *bounds))
        moments = [
            exact_moments(plant, each.gain_schedule, Laws(X0, P0, *model.noise), 1500) for each in (robust, classic)
        ]
        found[bounds] = [signals(each, 2) for each in moments]
    return SimpleNamespace(bound=robust.P, own=classic.P, found=found)


def diagonals(cov):
    """Variances over k."""
    return cov[:, [0, 1], [0, 1]]


@pytest.mark.parametrize("bounds", list(ENDS)[:2])
def test_published_variances_and_means_of_the_benchmark(published, bounds):
    """Oracle: the reference study section 5, an independent study, to the digits printed there (half a last digit)."""
    robust, classic = published.found[bounds]
    np.testing.assert_allclose(diagonals(robust["cov(e)"])[-1], ENDS[bounds]["robust"], atol=5.1e-4)
    np.testing.assert_allclose(diagonals(classic["cov(e)"])[-1], ENDS[bounds]["classic"], atol=5.1e-2)
    np.testing.assert_allclose(robust["mean(e)"][-1], ENDS[bounds]["mean"], atol=5.1e-4)


def test_the_classic_variance_grows_along_a_line(published):
    """Oracle: 0.2002 and 0.9692 a step, the reference study section 10 (the zero at z = 1); here of the last third."""
    variance = diagonals(published.found[-1.0, 1.0][1]["cov(e)"])
    np.testing.assert_allclose((variance[1500] - variance[1000]) / 500, [0.2002, 0.9692], atol=5.1e-5)


@pytest.mark.parametrize("bounds", ENDS)
def test_bounds_and_variances_meet_where_they_should(published, bounds):
    """Oracle: the reference study section 5: at which k the classic variance passes the robust bound, and its own."""
    robust, classic = (diagonals(each["cov(e)"]) for each in published.found[bounds])
    bound = diagonals(published.bound)
    for state, after in enumerate(ENDS[bounds]["after"]):
        np.testing.assert_array_equal(classic[2:, state] > bound[2:, state], np.arange(2, 1501) > after)
    assert (robust[1:] <= bound[1:]).all()
    assert (classic[1:] > diagonals(published.own)[1:]).all()


def test_published_moments_of_the_state(published):
    """Oracle: the reference study: mean of x towards (-0.1, -1) and (0.0625, -1.325); variance 3.62498 at k = 1."""
    for bounds, mean in (((-1.0, 1.0), (-0.1, -1.0)), ((0.0, 1.0), (0.0625, -1.325))):
        np.testing.assert_allclose(published.found[bounds][0]["mean(x)"][-1], mean, atol=1e-3)
    assert abs(published.found[-1.0, 1.0][0]["cov(e)"][1, 0, 0] - 3.62498) < 6e-6
    assert abs(published.bound[1, 0, 0] - 3.62537) < 6e-6


def test_the_state_does_not_depend_on_the_filter(published):
    """Oracle: the other filter's run of the same plant."""
    for robust, classic in published.found.values():
        np.testing.assert_allclose(robust["cov(x)"], classic["cov(x)"], rtol=1e-9)


def test_an_error_without_bounds_ends_in_infinity_and_not_in_a_warning():
    """Oracle: 3^(2k) grows beyond all numbers; pytest turns warnings into errors."""
    plant = design(1.0, 800, A=[3.0, 3.0], C=[[1.0, 1.0]], Bw=1.0, Dv=1.0, H_A=1.0, G_x=1.0)
    schedule = random_filter(np.random.default_rng(1), 2, 1, 0, "filter")
    found = exact_moments(plant, schedule.gain_schedule, Laws(np.zeros(2), np.eye(2), np.zeros(3), np.eye(3)), 800)
    named = signals(found, 2)
    assert not np.isfinite(named["cov(x)"][-1]).all() and np.isfinite(named["cov(e)"][300]).all()


def test_signals_of_moments():
    """Oracle: cov(x - x_hat) = X - S - S' + X_hat by hand."""
    mean, root = np.array([[1.0, 2.0, 3.0, 5.0]]), np.random.default_rng(1).standard_normal((4, 4))
    cov = root @ root.T
    named = signals(Moments(mean, cov[None]), 2)
    np.testing.assert_array_equal(named["mean(e)"], [[-2.0, -3.0]])
    expected = cov[:2, :2] - cov[:2, 2:] - cov[2:, :2] + cov[2:, 2:]
    np.testing.assert_allclose(named["cov(e)"][0], expected, atol=1e-13)
    np.testing.assert_array_equal(named["cov(x_hat)"][0], cov[2:, 2:])


class Heavy(Noise):
    """A law of noise with unknown moments."""

    def draw(self, rng, n_samples):
        """Draw Cauchy noise."""
        return rng.standard_cauchy((n_samples, 1))


def small():
    """A scalar plant with a method and a scenario that have exact moments."""
    model = models.design(5, A=0.5, C=1.0, Bw=1.0, Dv=1.0, W=1.0, V=1.0)
    plant = design(0.1, 5, A=0.5, C=1.0, Bw=1.0, Dv=1.0, H_A=0.1, G_x=1.0)
    filter_ = kalman_predictor.design(model, 5, x0=np.zeros(1), P0=np.eye(1))
    one = Gaussian(np.zeros(1), np.eye(1))
    parts = {"seed": 1, "uncertainty": {}, "parameters": {}, "reference": constant(1, value=0.0)}
    some = Scenario(x0=np.ones(1), x0_noise=(), process=(one, one), measurement=(), **parts)
    return plant, Method("m", filter_, Rest(1)), some, model


def test_laws_are_gathered_from_all_terms():
    """Oracle: two terms of process noise have variance 2; no measurement noise, no spread of x0."""
    plant, method, some, _ = small()
    laws = exact_laws(plant, method, some)
    np.testing.assert_array_equal(laws.U, [[2.0, 0.0], [0.0, 0.0]])
    np.testing.assert_array_equal(laws.X, [[0.0]])
    np.testing.assert_array_equal(laws.x, [1.0])
    shifted = Scenario(**{**vars(some), "x0_noise": (Gaussian(np.array([2.0]), np.array([[3.0]])),)})
    laws = exact_laws(plant, method, shifted)
    np.testing.assert_array_equal(laws.x, [3.0])
    np.testing.assert_array_equal(laws.X, [[9.0]])


@pytest.mark.parametrize(
    ("what", "why"),
    [("plant", "not linear"), ("run", "per run"), ("oracle", "depend on the run"), ("halfway", "depend on the run"),
     ("input", "a controller"), ("noise", "are not known"), ("x0", "are not known")],
)  # fmt: skip
def test_words_for_what_has_no_exact_moments(what, why):
    """Oracle: the reason, one by one."""
    plant, method, some, model = small()
    start = {"x0": np.zeros(1), "P0": np.eye(1)}
    if what == "plant":
        plant = Walk()
    elif what == "run":
        plant = design(0.1, 5, A=0.5, C=1.0, H_A=0.1, G_x=1.0, uncertainty=Uncertainty(per="run"))
    elif what == "oracle":
        method = method._replace(estimator=oracle.design(model, 5, plant, **start))
    elif what == "halfway":
        method = method._replace(estimator=Halfway())
    elif what == "input":
        method = method._replace(controller=Proportional())
    elif what == "noise":
        some = Scenario(**{**vars(some), "process": (Heavy(),)})
    else:
        some = Scenario(**{**vars(some), "x0_noise": (Heavy(),)})
    answer = exact_laws(plant, method, some)
    assert isinstance(answer, str) and why in answer


class Both(Plant):
    """Any plant with periods: one F (2 x 3) that sees states and noises, its two entries -1 or 1."""

    def __init__(self, rng, nx=2, ny=1, nn=3):
        """Draw M, H and G."""
        self.M, self.H, self.G = (rng.standard_normal(s) for s in ((nx + ny, nx + nn), (nx + ny, 2), (3, nx + nn)))

    def period(self, k):
        """Return the same period at every k."""
        return Period(self.M, np.zeros((2, 1)), (Channel(self.H, self.G, np.zeros((2, 3)), 1.0),))

    def at(self, signs):
        """M for given entries of F."""
        return self.M + self.H @ np.hstack([np.diag(signs), np.zeros((2, 1))]) @ self.G


def test_an_F_may_see_states_and_noises_at_once(rng):
    """Oracle: law of total covariance over all 64 sequences of signs of two entries over 3 steps."""
    plant, laws = (
        Both(rng),
        Laws(rng.standard_normal(2), random_psd(rng, 2), rng.standard_normal(3), random_psd(rng, 3)),
    )
    s = random_filter(rng, 2, 1)
    F, K, C, f, d = s.F[0], s.K[0], s.C[0], s.f[0], s.d[0]
    means, seconds = [], []
    for signs in corners(6):
        z, Z = np.concatenate([laws.x, s.x0]), np.zeros((4, 4))
        Z[:2, :2] = laws.X
        for k in range(3):
            T = plant.at(signs[2 * k : 2 * k + 2])
            A = np.block([[T[:2, :2], np.zeros((2, 2))], [K @ T[2:, :2], F - K @ C]])
            B = np.vstack([T[:2, 2:], K @ T[2:, 2:]])
            z = A @ z + B @ laws.n + np.concatenate([np.zeros(2), f - K @ d])
            Z = A @ Z @ A.T + B @ laws.U @ B.T
        means.append(z)
        seconds.append(Z + np.outer(z, z))
    mean = np.mean(means, axis=0)
    cov = np.mean(seconds, axis=0) - np.outer(mean, mean)
    ours = exact_moments(plant, s.gain_schedule, laws, 3)
    np.testing.assert_allclose(ours.mean[-1], mean, atol=1e-12 * np.abs(cov).max())
    np.testing.assert_allclose(ours.cov[-1], cov, atol=1e-12 * np.abs(cov).max())


KNOWN = {
    "plant": "{kind: linear, A: 0.9, B: 1, C: 1}",
    "model": "{from: plant, P_w: 1, P_v: 1}",
    "initial": "{x: 0, x_hat: 0, P: 1}",
    "time": "{steps: 3}",
    "input": "{kind: steps, times: [0, 1, 2], values: [1, 2, -1]}",
    "methods": "{KF: {estimator: {kind: kalman}}, P: {estimator: {kind: kalman-predictor}}}",
    "evaluate": "moments",
}


def moments_of(config, method):
    """Laws and exact moments of a method of a configuration."""
    experiment = config.experiment
    made = experiment.method(method)
    laws = exact_laws(experiment.plant, made, experiment.scenario)
    return exact_moments(experiment.plant, made.estimator.gain_schedule, laws, experiment.n_steps)


@pytest.mark.parametrize("method", ["KF", "P"])
def test_a_known_input_moves_the_means(tmp_path, method):
    """Oracle: 0.9 x + u by hand; covariances are those without an input, and the means of x and x_hat agree."""
    found = moments_of(load_config(write_estimation(tmp_path, **KNOWN)), method)
    np.testing.assert_allclose(found.mean, np.outer([0.0, 1.0, 2.9, 1.61], [1.0, 1.0]), **ROUND)
    rest = moments_of(load_config(write_estimation(tmp_path, **(KNOWN | {"input": None}))), method)
    np.testing.assert_array_equal(found.cov, rest.cov)
    assert not rest.mean.any()


def test_a_known_input_of_an_uncertain_plant(tmp_path):
    """Oracle: a simulation of its own, within 5 standard errors; a state away from 0 has more uncertainty."""
    plant = "{kind: uncertain-linear, A: 0.9, B: 1, Bw: 1, C: 1, Dv: 1, H_A: 0.3, G_x: 1, uncertainty: %s}"
    keys = KNOWN | {"plant": plant % "{law: uniform, low: -1, high: 1}", "model": "{from: plant, W: 1, V: 1}"}
    found = moments_of(load_config(write_estimation(tmp_path, **keys)), "KF")
    rng = np.random.default_rng(4)
    x, u = np.zeros(20_000), [1.0, 2.0, -1.0]
    for k in range(3):
        x = (0.9 + 0.3 * rng.uniform(-1, 1, len(x))) * x + u[k] + rng.standard_normal(len(x))
    e = x - found.mean[-1, 0]
    assert abs(e.mean()) < 5 * e.std() / np.sqrt(len(x))
    assert abs((e**2).mean() - found.cov[-1, 0, 0]) < 5 * (e**2).std() / np.sqrt(len(x))
    rest = moments_of(load_config(write_estimation(tmp_path, **(keys | {"input": None}))), "KF")
    assert found.cov[-1, 0, 0] > rest.cov[-1, 0, 0] + 0.1


def test_inputs_that_have_no_exact_moments(tmp_path):
    """Oracle: files of several runs, and a controller."""
    for i in range(6):
        (tmp_path / f"u{i}.csv").write_text(f"u\n{i}\n1\n2\n", encoding="utf-8")
    path = write_estimation(tmp_path, **(KNOWN | {"input": "{file: 'u*.csv'}"}))
    with pytest.raises(ConfigError, match="KF has no exact moments: every run has an input of its own"):
        load_config(path)
    one = load_config(write_estimation(tmp_path, **(KNOWN | {"input": "{file: u3.csv}"})))
    np.testing.assert_allclose(moments_of(one, "KF").mean[1], 3.0, **ROUND)
