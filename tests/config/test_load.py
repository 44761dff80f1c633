"""What a configuration means: plant, design model, and short forms."""

import math

import numpy as np
import pytest
from conftest import ROUND
from small_experiment import KEYS, write

from rmpc_bench import load_config
from rmpc_bench.noise.distributions import Choice, Fixed, Normal, Uniform

NAMED = "{dist: normal, std: 5%, truncate: 3}"


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the small experiment with some keys replaced."""
    return lambda **keys: load_config(write(tmp_path, **keys))


def design(config, method, part):
    """Return the estimator or controller of a method."""
    return getattr(config.experiment.method(method), part)


@pytest.mark.parametrize(
    ("yaml", "law"),
    [
        ("+-10%", Uniform(-0.1, 0.1)),
        ("±0.5", Uniform(-0.5, 0.5)),
        ("+-sqrt(4)", Uniform(-2.0, 2.0)),
        ("{dist: uniform, low: -10%, high: 1/2}", Uniform(-0.1, 0.5)),
        (NAMED, Normal(0.05, 0.0, 3.0)),
        ("{dist: normal, std: 0.1, mean: 1}", Normal(0.1, 1.0, None)),
        ("{dist: choice, values: [1, 5%, 2*pi]}", Choice((1.0, 0.05, 2 * math.pi))),
        ("{dist: fixed, value: 10%}", Fixed(0.1)),
    ],
)
def test_laws_of_an_uncertain_quantity(load, yaml, law):
    """Every way to write one."""
    config = load(uncertainty=f"{{eps: {yaml}, other: +-1%}}")
    assert config.experiment.scenario.uncertainty == {"eps": law, "other": Uniform(-0.01, 0.01)}


@pytest.mark.parametrize(
    ("plant", "value"),
    [
        ("{kind: servo-linear, perturb: {J_l: 1 + eps}}", 25.0 * 1.1),
        ("{kind: servo-linear, J_l: 20, perturb: {J_l: 2*(1 + eps)}}", 20.0 * 2 * 1.1),
        ("{kind: servo-linear, set: {J_l: 20 + eps}}", 20.1),
        ("{kind: servo-linear, J_l: 20, set: {J_l: 3}}", 3.0),
        ("{kind: servo-linear, perturb: {J_l: 110%}}", 25.0 * 1.1),
    ],
)
def test_perturb_is_a_factor_and_set_a_value(load, plant, value):
    """Of a parameter of the plant, in terms of the named quantities."""
    parameters = load(plant=plant).experiment.scenario.parameters
    assert list(parameters) == ["J_l"]
    np.testing.assert_allclose(parameters["J_l"]({"eps": 0.1}), value, **ROUND)


def test_parameters_of_the_plant_are_not_those_of_the_model(load):
    """The design model keeps its own parameters."""
    config = load(plant="{kind: servo-linear, J_l: 20}")
    assert config.experiment.plant.nominal["J_l"] == 20.0
    assert config.methods["S-MPC"]["model"]["J_l"] == 25.0


@pytest.mark.parametrize(
    ("noise", "process", "measurement"),
    [
        ("none", None, None),
        ("{process: none}", None, None),
        ("{measurement: none, process: none}", None, None),
        ("same", 1.0, 1.0),
        ("{process: same}", 1.0, None),
        ("{measurement: {same: {scale: 1%}}}", None, 0.01),
        ("{process: {same: {scale: 2}}, measurement: same}", 2.0, 1.0),
    ],
)
def test_noise_of_the_design_model(load, noise, process, measurement):
    """`same` is the model's own; a scale multiplies the standard deviation."""
    experiment = load(noise=noise, model="{kind: servo-linear, noise: {process: 1.0, measurement: 0.5}}").experiment
    assert [len(experiment.scenario.process), len(experiment.scenario.measurement)] == [
        process is not None,
        measurement is not None,
    ]
    for term in experiment.scenario.measurement:
        np.testing.assert_allclose(term.root, [[0.5 * measurement]], **ROUND)
    for term in experiment.scenario.process:
        P_w = process**2 * design(load(initial="{P: process}"), "S-MPC", "estimator").series()["P_pred"][0]
        np.testing.assert_allclose(term.root @ term.root.T, P_w, rtol=1e-9, atol=1e-15)  # root of a nearly singular P_w


@pytest.mark.parametrize(
    ("law", "mean", "cov"),
    [
        ("{std: 0.5}", np.zeros(4), 0.25 * np.eye(4)),
        ("{std: [1, 2, 0, 50%], mean: 1}", np.ones(4), np.diag([1.0, 4.0, 0.0, 0.25])),
        ("{cov: 4, scale: 1/2}", np.zeros(4), np.eye(4)),
        ("{cov: [1, 2, 3, 4], mean: [1, 2, 3, 4]}", np.arange(1.0, 5.0), np.diag(np.arange(1.0, 5.0))),
        ("{cov: 0}", np.zeros(4), np.zeros((4, 4))),
    ],
)
def test_gaussian_noise_per_channel(load, law, mean, cov):
    """Standard deviation or covariance, in every short form."""
    [term] = load(noise=f"{{process: {{gaussian: {law}}}}}").experiment.scenario.process
    np.testing.assert_array_equal(term.mean, mean)
    np.testing.assert_allclose(term.root @ term.root.T, cov, atol=1e-15, **ROUND)


def test_initial_state_is_a_vector_or_a_law(load):
    """A number goes for all coordinates; a law deviates from 0."""
    assert load(initial="{x: 2*pi}").experiment.scenario.x0.tolist() == [2 * math.pi] * 4
    assert load(initial="{x: [1, 2, 3, 50%]}").experiment.scenario.x0.tolist() == [1.0, 2.0, 3.0, 0.5]
    scenario = load(initial="{x: {gaussian: {std: 2, mean: 1}}}").experiment.scenario
    assert scenario.x0.tolist() == [0.0] * 4
    [deviation] = scenario.x0_noise
    assert deviation.mean.tolist() == [1.0] * 4
    assert deviation.root.tolist() == (2 * np.eye(4)).tolist()
    assert load().experiment.scenario.x0_noise == ()


def test_start_of_the_estimators(load):
    """A number is times the identity, a list a diagonal, `process` the model's noise."""
    starts = {}
    for P in ("2", "[2, 2, 2, 2]", "[[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 2]]", "process"):
        estimator = design(load(initial=f"{{x_hat: [1, 2, 3, 4], P: {P}}}"), "S-MPC", "estimator")
        assert estimator.x0.tolist() == [1.0, 2.0, 3.0, 4.0]
        starts[P] = estimator.series()["P_pred"][0]
    *written, process = starts.values()
    assert all(np.allclose(start, 2 * np.eye(4), rtol=1e-15, atol=0.0) for start in written)
    assert process.tolist() != written[0].tolist()


@pytest.mark.parametrize(("Q", "R"), [("0.1", "0.2"), ("[10%]", "[20%]"), ("[[0.1]]", "[[1/5]]")])
def test_a_weight_is_a_number_a_list_or_a_matrix(load, Q, R):
    """All three give the same controller."""
    short = design(load(controller="{kind: mpc, Hp: 9, Hu: 3, Q: 0.1, R: 0.2}"), "S-MPC", "controller")
    same = design(load(controller=f"{{kind: mpc, Hp: 9, Hu: 3, Q: {Q}, R: {R}}}"), "S-MPC", "controller")
    assert same.K_x.tolist() == short.K_x.tolist()


def test_a_method_of_the_same_kind_changes_single_keys(load):
    """Without a kind, or with the same, the default is kept where nothing else is said."""
    config = load(
        estimator="{kind: robust-kalman, c: 0.1}",
        methods="""{a: {}, b: , c: {estimator: {c: 1%}, controller: {Hu: 2, scale: {u: 220}}},
                    d: {controller: {kind: mpc, limits: {u: [-1, 1]}}, label: "D"}}""",
    )
    methods = config.methods
    assert methods["a"] == methods["b"]
    assert [methods[name]["estimator"]["c"] for name in "abcd"] == [0.1, 0.1, 0.01, 0.1]
    c, d = methods["c"]["controller"], methods["d"]["controller"]
    assert (c["Hp"], c["Hu"], c["scale"]) == (10, 2, {"u": 220.0, "y": 2 * math.pi})
    assert d["limits"] == {"u": [-1.0, 1.0], "enforce": "clip"} and d["Hu"] == 3
    assert config.labels == {"a": "a", "b": "b", "c": "c", "d": "D"}


def test_a_method_of_another_kind_replaces_the_default(load):
    """Nothing of the default's keys remains; `form`, which came later, is left out at its default."""
    config = load(
        estimator="{kind: robust-kalman, c: 0.1}",
        methods="{a: {estimator: {kind: kalman}}, b: {estimator: {kind: risk-sensitive, theta_from: {c: 0.1}}}}",
    )
    assert config.methods["a"]["estimator"] == {"kind": "kalman"}
    assert config.methods["b"]["estimator"] == {
        "kind": "risk-sensitive",
        "theta_from": {"c": 0.1, "kl": "printed"},
        "tau": 0.0,
    }


def test_a_method_may_have_another_model(load):
    """Merged over the default like the other components; the plant stays the same."""
    config = load(methods="{a: {estimator: {kind: kalman}}, b: {estimator: {kind: kalman}, model: {J_l: 5}}}")
    assert [config.methods[name]["model"]["J_l"] for name in "ab"] == [25.0, 5.0]
    assert config.methods["b"]["model"]["noise"] == {"process": 1.0, "measurement": 1.0}
    assert config.experiment.plant.nominal["J_l"] == 25.0


def test_numbers_may_be_arithmetic_everywhere(load):
    """The same experiment, written in numbers and in quantities."""
    written = load(
        **{"seed": "7.0", "runs": "2*3", "version": "1", "time": "{step: 10%, steps: 20/2}"},
        plant="{kind: servo-linear, J_l: sqrt(625), perturb: {J_l: 1 + eps}}",
        model="{kind: servo-linear, noise: {process: 100%, measurement: 2/2}}",
        noise="{measurement: {gaussian: {std: 1%}}}",
        initial="{x: 1 - 1, x_hat: [0, 0*pi, 0%, sin(0)], P: 4/2}",
        reference="{kind: constant, value: [pi/2]}",
        metrics="[{kind: mse, from: 1 + 1, to: 4*2}, {kind: settling_time, band: 5%}]",
        statistics="{confidence: 95%, relevant: 1/100}",
        execution="{workers: 4/2, block: 5*10, max_failures: 1 - 1}",
        smoke="{runs: 2*2, steps: 40/2}",
    )
    plain = load(
        initial="{x: 0, x_hat: [0, 0, 0, 0], P: 2}",
        reference="{kind: constant, value: [1.5707963267948966]}",
        metrics="[{kind: mse, from: 2, to: 8}, {kind: settling_time, band: 0.05}]",
        execution="{block: 50}",
    )
    assert written.resolved == plain.resolved
    assert written.full_hash == plain.full_hash


@pytest.mark.parametrize(
    ("time", "metric", "window"),
    [
        ("{step: 0.1, steps: 50}", "mse", (0, 49)),
        ("{step: 0.1, steps: 50}", "{kind: mse, from: 3, to: 10}", (3, 10)),
        ("{step: 0.1, steps: 50}", "{kind: mse, to: N}", (0, 50)),
        ("{step: 0.1, duration: 5}", "{kind: mse, from: 3, to: 4}", (30, 40)),
        ("{step: 0.1, duration: 5}", "{kind: mse, from: 0.3}", (3, 49)),
        ("{step: 0.1, duration: 5}", "{kind: mse, to: 5}", (0, 50)),
        ("{step: 0.1, duration: 5}", "{kind: mse, from: N, to: N}", (50, 50)),
        ("{step: 0.1, duration: 5}", "settling_time", (0, 50)),
        ("{step: 0.1, duration: 5}", "input_power", (0, 49)),
        ("{step: 0.1, duration: 5}", "{kind: input_power, from: 3}", (30, 49)),
    ],
)
def test_windows_are_given_in_the_unit_of_time(load, time, metric, window):
    """Seconds with a duration, samples with steps; both ends belong to the window."""
    experiment = load(time=time, metrics=f"[{metric}]").experiment
    assert experiment.metrics[0].window(experiment.metric_layout) == window


def test_metrics_have_names_and_units(load):
    """The kind unless a name is given; units are the plant's."""
    config = load(metrics="[mse, {kind: mse, name: mse_end, from: 5}, input_power, settling_time]")
    infos = config.experiment.metric_infos
    assert [info.name for info in infos] == ["mse", "mse_end", "input_power", "settling_time"]
    assert [info.unit for info in infos] == ["rad^2", "rad^2", "V^2", "s"]
    assert config.primary == "mse" and config.baseline == "S-MPC"


def test_defaults(load):
    """What a configuration may leave out."""
    config = load(**dict.fromkeys(["seed", "noise", "initial", "reference", "metrics", "figures"]))
    assert config.experiment.scenario.seed == 0
    assert config.experiment.scenario.measurement == ()
    assert list(config.points[0].metrics) == ["mse"]
    assert [part.kind for part in config.figures] == ["boxplot"]
    assert (config.execution.workers, config.execution.block, config.execution.max_failures) == (2, "auto", 0)
    assert (config.statistics.confidence, config.statistics.relevant) == (0.95, 0.01)


@pytest.mark.parametrize(
    ("statistics", "relevant", "margins"),
    [("{}", 0.01, {}), ("{relevant: 2%}", 0.02, {}), ("{relevant: {mse: 3%}}", 0.01, {"mse": 0.03})],
)
def test_smallest_relevant_difference(load, statistics, relevant, margins):
    """A relative change for all metrics, or a number per metric; both averages unless one is asked for."""
    config = load(statistics=statistics)
    assert (config.statistics.relevant_change, config.statistics.margins) == (relevant, margins)
    assert config.statistics.average == "both"


@pytest.mark.parametrize(
    ("check", "headline"),
    [
        ("mean( mse[R-MPC]) < mean(mse[S-MPC])", "mean"),
        ("ratio(mse[R-MPC], mse[S-MPC]) < 1", "geometric"),
        ("mean(input_power[R-MPC]) < mean(input_power[S-MPC])", "geometric"),
        ("median(mse[R-MPC]) < median(mse[S-MPC])", "geometric"),
        ("mean(mse[R-MPC]) < ratio(mse[R-MPC], mse[S-MPC])", "geometric"),
    ],
)
def test_verdicts_rest_on_the_average_that_the_claims_name(load, check, headline):
    """Of the primary metric; the geometric mean where they name both or none."""
    config = load(claims=f"[{{says: it is better, check: '{check}'}}]", metrics="[mse, input_power]")
    assert config.headline == headline


def test_size_of_a_smoke_run(tmp_path):
    """The smaller of the two sizes; windows beyond the end are cut."""
    path = write(tmp_path, time="{step: 0.1, duration: 5}", runs=3, metrics="[mse, {kind: mse, name: m, from: 3}]")
    config = load_config(path, smoke=True)
    assert (config.experiment.n_runs, config.experiment.n_steps) == (3, 20)
    assert config.experiment.metrics[1].window(config.experiment.metric_layout) == (20, 20)
    path = write(tmp_path, time="{step: 0.1, steps: 5}", runs=30, smoke="{runs: 2}")
    config = load_config(path, smoke=True)
    assert (config.experiment.n_runs, config.experiment.n_steps) == (2, 5)


def test_the_small_experiment_is_what_it_says():
    """The table these tests start from has one line per key."""
    assert all("\n" not in line for line in KEYS.values())
