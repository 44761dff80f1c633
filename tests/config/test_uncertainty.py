"""Uncertain plants in configurations: laws, an adversary, oracles, correlated noise, and what identifies them."""

import numpy as np
import pandas as pd
import pytest
from conftest import ROUND
from small_experiment import cli, ran, spied, write
from uncertain_experiment import METHODS, PLANT, write_estimation

from rmpc_bench import load_config, load_trials
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.noise.distributions import Choice, Fixed, Normal, Uniform
from rmpc_bench.types import ConfigError

LAW = "{law: uniform, low: -1, high: 1}"
ORACLE = "{KF: {estimator: {kind: kalman-predictor}}, G: {estimator: {kind: oracle}}}"
ONE = "{KF: {estimator: {kind: kalman-predictor}}}"
MPC = "{kind: mpc, Hp: 5, Hu: 2, Q: 1, R: 1}"
QP = MPC[:-1] + ", limits: {u: [-1, 1], enforce: qp}}"
B = PLANT.replace("Bw:", "B: [[0], [1]], Bw:")
SERVO = {
    "plant": "{kind: servo}",
    "model": "{kind: servo-linear, noise: {process: 1, measurement: 1}}",
    "noise": "none",
    "time": "{step: 0.1, steps: 10}",
    "initial": "{x: 0}",
    "controller": MPC,
    "metrics": "[mse]",
}


def law(text):
    """The plant under another law of its uncertainty."""
    return PLANT.replace(LAW, text)


def problems(path, **keys):
    """Return what is wrong with a configuration, each without its file."""
    with pytest.raises(ConfigError) as caught:
        load_config(path, **keys)
    return [str(problem).removeprefix(f"{path}:") for problem in caught.value.problems]


def sequence(config, runs=range(2)):
    """F_x of some runs."""
    experiment = config.experiment
    return experiment.scenario.draw(experiment.plant, runs, experiment.n_steps).delta.F_x


AGAINST = "plant.uncertainty.against: "
WRONG = {
    "an unknown method": (
        {"plant": law("{law: greedy, against: KG}")},
        AGAINST + "'KG' is not a known method; did you mean 'KF'?",
    ),
    "a oracle": (
        {"plant": law("{law: greedy, against: G}"), "methods": ORACLE},
        AGAINST + "G: the gains of the estimator depend on the run",
    ),
    "a controller": (
        {"plant": B.replace(LAW, "{law: greedy, against: KF}"), "controller": MPC, "methods": ONE},
        AGAINST + "KF: there is a controller",
    ),
    "nobody": (
        {"plant": law("{law: greedy}")},
        "plant.uncertainty: against must name the method whose error the greedy law maximises",
    ),
    "radius": (
        {"plant": law("{law: greedy, against: KF, radius: -1}")},
        "plant.uncertainty.radius: must be > 0 (got -1)",
    ),
    "bounds": (
        {"plant": law("{law: greedy, against: KF, low: -1}")},
        "plant.uncertainty: the law 'greedy' has no low; it takes against, radius",
    ),
    "a number": ({"plant": law("{law: greedy, against: 3}")}, AGAINST + "expected text (got 3)"),
    "a channel": (
        {"plant": law("{law: fixed, value: {q: 1}}")},
        "plant.uncertainty.value.q: must be 'x', 'w' or 'v' (got 'q')",
    ),
    "no law": ({"plant": law("uniform")}, "plant.uncertainty: must be a mapping (got 'uniform')"),
    "a oracle of a servo": (
        {**SERVO, "methods": "{G: {estimator: {kind: oracle}}}"},
        "methods.G.estimator: needs plant and model of a kind with uncertain matrices, such as uncertain-linear",
    ),
    "perturb": (
        {"plant": PLANT.replace("Dv:", "perturb: {A: 1 + eps}, Dv:"), "uncertainty": "{eps: +-10%}"},
        "plant.perturb.A: uncertain-linear has no named parameters; an uncertain entry of A is written with the kind",
    ),
    "k in a covariance": (
        {"model": '{from: plant, W: "1 + k", V: 1}'},
        "model.W: column 5 of '1 + k': unknown name 'k'",
    ),
    "no value at a late k": (
        {"plant": PLANT.replace("0.7", '"sqrt(5 - k)"')},
        "plant.A: has no value at k = 6: column 1 of 'sqrt(5 - k)': sqrt of a negative number (-1.0)",
    ),
    "rows of several lengths": (
        {"plant": PLANT.replace("[0, 0.7]", "[0]")},
        "plant.A: must be a number or a list of rows of the same length",
    ),
    "text": (
        {"plant": PLANT.replace("[[0.9, 0.2], [0, 0.7]]", "foo")},
        "plant.A: column 1 of 'foo': unknown name 'foo'",
    ),
    "a wrong start": ({"initial": "{x: [1, 2, 3], P: 1}"}, "initial.x: shape (3,) does not fit"),
    "states of the model": (
        {"model": "{kind: uncertain-linear, A: 0.5, C: 1, W: 1, V: 1}", "initial": "{x: 0, P: 1}", "methods": ONE,
         "noise": "none"},
        "x_hat of method 'KF' has 1 components and x of the plant 2",
    ),
    "a model over time": (
        {"plant": B.replace("0.7", '"0.7*cos(k)"'), "controller": QP, "methods": ONE},
        "controller: qp and `law: printed` need a constant prediction model; this model varies with k",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", WRONG)
def test_mistakes(tmp_path, mistake):
    """One line at a place of the file, and no traceback."""
    keys, message = WRONG[mistake]
    path = write_estimation(tmp_path, **keys)
    assert any(message in line for line in problems(path)), problems(path)
    result = cli("check", path)
    assert result.exit_code == 2
    assert all(line.startswith(f"{path}:") for line in result.stderr.splitlines())


GAUSSIAN = "process: {gaussian: {std: 1}}, measurement: {gaussian: {std: 1}}"
CROSS = {
    f"{{{GAUSSIAN}, cross: 1.5}}": "the joint covariance of the noises with this cross-covariance is not",
    f"{{{GAUSSIAN}, cross: [[0.5, 1]]}}": "shape (1, 2) does not fit: 1 x 1 numbers are required",
    f"{{{GAUSSIAN}, cross: [[0.5, 1], [1]]}}": "must be a number or a list of rows of the same length",
    f"{{{GAUSSIAN}, cross: [1]}}": "expected a number or a matrix (got a list of 1)",
    f"{{{GAUSSIAN}, cross: foo}}": "column 1 of 'foo': unknown name 'foo'",
    "{process: {gaussian: {std: 1}}, cross: 0.5}": "a cross-covariance needs one gaussian law for the process and one",
}  # fmt: skip


@pytest.mark.parametrize("noise", CROSS)
def test_wrong_cross_covariances(tmp_path, noise):
    """At the key `cross`."""
    path = write_estimation(tmp_path, noise=noise)
    column = path.read_text(encoding="utf-8").splitlines()[7].index("cross:") + 8
    (line,) = problems(path)
    assert line.startswith(f"8:{column}: noise.cross: ") and CROSS[noise] in line


def test_correlated_noise_is_another_experiment(tmp_path):
    """The cross-covariance is that of the plant; none and zero are the same."""
    noises = [f"{{{GAUSSIAN}}}", f"{{{GAUSSIAN}, cross: 0}}", f"{{{GAUSSIAN}, cross: 0.5}}"]
    plain, zero, half = (load_config(write_estimation(tmp_path, noise=noise)).hash for noise in noises)
    assert plain == zero != half


def test_noise_of_the_design_model(tmp_path):
    """`same` takes the model's cross-covariance along, and another one is another experiment."""
    models = ["{from: plant, W: 1, V: 1}", "{from: plant, W: 1, V: 1, S: 0.5}"]
    configs = [load_config(write_estimation(tmp_path, model=model, methods=ONE)) for model in models]
    assert configs[0].experiment.scenario.cross is None
    np.testing.assert_array_equal(configs[1].experiment.scenario.cross, [[0.5]])
    assert configs[0].hash != configs[1].hash


def test_another_law_is_another_experiment(tmp_path):
    """Exit 5 with the difference; runs, methods, metrics and what is evaluated may grow in place."""
    path = write_estimation(tmp_path)
    ran(path, tmp_path / "out")
    for text in ("{law: uniform, low: 0, high: 1}", "{law: uniform, per: run}", "{law: fixed}", "{law: extremes}"):
        result = cli("run", write_estimation(tmp_path, plant=law(text)), "-o", tmp_path / "out", "-j", 1)
        assert result.exit_code == 5, text
        assert "plant.uncertainty." in result.stderr and "for a new directory: rmpc-bench run" in result.stderr
    more = METHODS.replace("{KF:", "{G: {estimator: {kind: oracle}}, KF:")
    keys = {"runs": 8, "methods": more, "metrics": "[estimation_mse, nees]", "evaluate": "[runs, moments]"}
    assert cli("run", write_estimation(tmp_path, **keys), "-o", tmp_path / "out", "-j", 1).exit_code == 0


def test_defaults_of_a_law_are_the_law(tmp_path):
    """What is given and what is filled in are the same experiment."""
    texts = ["{law: uniform, low: -1, high: 1, per: step}", "{law: uniform}", "{low: -1}", "{}"]
    assert len({load_config(write_estimation(tmp_path, plant=law(text))).full_hash for text in texts}) == 1


def test_the_adversary_is_part_of_the_plant(tmp_path):
    """Another opponent, another radius, or another definition of the opponent is another experiment; a label is not."""
    greedy = law("{law: greedy, against: ERP}")

    def found(plant=greedy, **keys):
        return load_config(write_estimation(tmp_path, plant=plant, **keys)).hash

    first = found()
    assert found(law("{law: greedy, against: KF}")) != first
    assert found(law("{law: greedy, against: ERP, radius: 0.5}")) != first
    assert found(methods=METHODS.replace("gamma: 5", "gamma: 6")) != first
    assert found(model="{from: plant, W: 2, V: 1}", noise="none") != found(noise="none")
    assert found(methods=METHODS.replace("gamma: 5}", "gamma: 5}, label: x")) == first
    assert found(methods=METHODS.replace("kind: kalman-predictor", "kind: kalman")) == first
    assert found(runs=9, metrics="[nees]") == first


def test_a_directory_with_an_adversary(tmp_path):
    """It refuses another opponent with the difference, and takes a method beside it."""
    greedy = law("{law: greedy, against: ERP}")
    ran(write_estimation(tmp_path, plant=greedy), tmp_path / "out")
    changed = METHODS.replace("gamma: 5", "gamma: 6")
    result = cli("run", write_estimation(tmp_path, plant=greedy, methods=changed), "-o", tmp_path / "out")
    assert result.exit_code == 5 and "against.estimator.gamma: there 5.0, here 6.0" in result.stderr
    more = METHODS.replace("{KF:", "{G: {estimator: {kind: oracle}}, KF:")
    ran(write_estimation(tmp_path, plant=greedy, methods=more), tmp_path / "out")


def test_the_adversary_meets_every_method_and_run_alike(tmp_path):
    """One sequence of extreme F for all, within the radius; other methods do not change it."""
    greedy = law("{law: greedy, against: ERP, radius: 0.5}")
    config = load_config(write_estimation(tmp_path, plant=greedy))
    F = sequence(config, range(3))
    np.testing.assert_array_equal(np.abs(F[:, :-1]), 0.5)
    np.testing.assert_array_equal(F[0], F[2])
    other = load_config(write_estimation(tmp_path, plant=greedy, methods=METHODS.replace("kalman-predictor", "kalman")))
    np.testing.assert_array_equal(sequence(other, range(3)), F)


@pytest.mark.parametrize("smoke", [False, True])
def test_an_adversary_per_point(tmp_path, smoke):
    """A sweep over what the opponent is: the sequence of each point is that of the point alone."""
    plant = PLANT.replace("[[1, 0]], Dv", "[[1, 0.5]], Dv").replace(LAW, "{law: greedy, against: ERP}")
    keys = {"plant": plant, "time": "{steps: 40}", "smoke": "{steps: 9}"}
    gammas = ("5", "500")
    sweep = f"{{grid: {{methods.ERP.estimator.gamma: [{', '.join(gammas)}], plant.uncertainty.radius: [1, 3]}}}}"
    config = load_config(write_estimation(tmp_path, sweep=sweep, **keys), smoke=smoke)
    for point in config.points:
        gamma, radius = point.coordinates.values()
        own = keys | {
            "methods": METHODS.replace("gamma: 5", f"gamma: {gamma}"),
            "plant": plant.replace("against: ERP", f"against: ERP, radius: {radius}"),
        }
        alone = load_config(write_estimation(tmp_path, **own), smoke=smoke)
        assert point.experiment_hash == alone.points[0].experiment_hash
        for ours, theirs in zip(point.experiment.plant.worst, alone.experiment.plant.worst, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_the_oracle_of_every_point(tmp_path):
    """It gets the matrices and the F of its own point: the trials are those of the point alone."""
    sweep = "{grid: {plant.H_A: {small: [[0], [0.1]], large: [[0], [0.5]]}}}"
    keys = {
        "methods": ORACLE,
        "model": "{kind: uncertain-linear, A: 0.9, C: [[1, 0]], Bw: [[1], [0.5]], Dv: 1, W: 1, V: 1}",
    }
    ran(write_estimation(tmp_path, sweep=sweep, **keys), tmp_path / "sweep")
    swept = load_trials(tmp_path / "sweep")
    for name, H in (("small", "[[0], [0.1]]"), ("large", "[[0], [0.5]]")):
        ran(write_estimation(tmp_path, plant=PLANT.replace("[[0], [0.1]]", H), **keys), tmp_path / name)
        frame = swept.frame[swept.frame["plant.H_A"] == name].drop(columns="plant.H_A")
        alone = load_trials(tmp_path / name).frame
        pd.testing.assert_frame_equal(frame.reset_index(drop=True), alone, check_exact=True)


def test_the_oracle_of_a_fixed_uncertainty_is_the_kalman_predictor(tmp_path):
    """A model with the same matrices gives the same estimator."""
    methods = "{KF: {estimator: {kind: kalman-predictor}}, G: {estimator: {kind: oracle}}}"
    ran(write_estimation(tmp_path, plant=law("{law: fixed, value: 0}"), methods=methods), tmp_path / "out")
    frame = load_trials(tmp_path / "out").frame
    values = [frame[frame["method"] == name]["estimation_mse"].to_numpy() for name in ("KF", "G")]
    np.testing.assert_allclose(values[0], values[1], rtol=1e-9)


def test_oracles_are_marked(tmp_path):
    """In the table, on the screen and in the ensemble; never the other methods."""
    path = write_estimation(tmp_path, methods=ORACLE, evaluate="[runs, ensemble]")
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1)
    page = (tmp_path / "out" / "tables" / "summary.md").read_text(encoding="utf-8")
    assert result.stdout.count("(oracle)") == 2 and "G (oracle)" in result.stdout
    assert "G (oracle)" in page and "KF (oracle)" not in page and "An oracle knows the true parameters." in page
    assert load_trials(tmp_path / "out").oracles == {"G"}


def test_a_controller_with_an_uncertain_model(tmp_path):
    """It predicts with the nominal part: the same runs as with a model without uncertainty."""
    keys = {"plant": B, "controller": MPC, "methods": ONE, "reference": "{kind: constant, value: 1}"}
    first = ran(write_estimation(tmp_path, **keys), tmp_path / "a")
    certain = "{from: plant, H_A: 0, G_x: 0, W: 1, V: 1}"
    assert ran(write_estimation(tmp_path, model=certain, **keys), tmp_path / "b") == first


def test_matrices_over_time_run(tmp_path, monkeypatch):
    """A plant that changes with k goes through runs and moments, whatever the block."""
    plant = PLANT.replace("0.7", '"0.6*(1 + 0.1*sin(k))"')
    path = write_estimation(tmp_path, plant=plant, evaluate="[runs, moments]")
    first = ran(path, tmp_path / "a")
    assert ran(path, tmp_path / "b", "-s", "execution.block=4") == first
    blocks = spied(monkeypatch)
    assert ran(path, tmp_path / "a") == first and blocks == []


def test_the_ensemble_comes_near_the_exact_moments(tmp_path):
    """Oracle: 400 runs; the mean of e within five standard errors of the exact one, its variance within a third."""
    path = write_estimation(tmp_path, runs=400, evaluate="[runs, moments]")
    ran(path, tmp_path / "out")
    series = load_trials(tmp_path / "out").series
    series = series[series["method"] == "ERP"]
    exact, sampled = series[series["n"] == 0], series[series["n"] == 400]

    def last(part, quantity):
        chosen = part[(part["quantity"] == quantity) & (part["k"] == 12)].set_index("component")["value"]
        return chosen

    for i in ("0", "1"):
        variance = last(exact, "cov(e)")[f"{i},{i}"]
        assert abs(last(sampled, "mean(e)")[i] - last(exact, "mean(e)")[i]) < 5 * np.sqrt(variance / 400)
        assert abs(last(sampled, "cov(e)")[f"{i},{i}"] / variance - 1) < 5 * np.sqrt(2 / 400)


LAWS = (
    (Uniform(-0.1, 0.3), 0.1),
    (Normal(0.2, 1.0, truncate=2.0), 1.0),
    (Choice((1.0, 2.0, 6.0)), 3.0),
    (Fixed(0.4), 0.4),
)


def loaded(tmp_path, uncertainty, **keys):
    """A small configuration with these uncertain quantities; a key that is None is as in the small experiment."""
    given = {name: value for name, value in keys.items() if value is not None}
    return load_config(write(tmp_path, uncertainty=uncertainty, **given))


@pytest.mark.parametrize(("law", "centre"), LAWS)
@pytest.mark.parametrize("factor", [0.0, 0.5, 1.0, 3.0])
def test_every_quantile_moves_about_the_centre(law, centre, factor):
    """The same uniform number gives the centre plus the factor times the deviation, so that points are paired."""
    p = np.array([0.0, 0.1, 0.3, 0.5, 0.77, 0.999])
    expected = centre + factor * (np.array([law.quantile(each) for each in p]) - centre)
    np.testing.assert_allclose([law.scaled(factor).quantile(each) for each in p], expected, **ROUND, atol=1e-15)
    assert law.scaled(1.0) == law


def test_scale_one_changes_nothing(tmp_path):
    """Neither the identity of the experiment nor what is written."""
    plain_one, one = loaded(tmp_path, "{eps: +-20%}"), loaded(tmp_path, "{eps: +-20%, scale: 1}")
    assert (one.hash, one.resolved) == (plain_one.hash, plain_one.resolved)
    assert loaded(tmp_path, "{eps: +-20%, scale: 2}").hash != one.hash


def test_a_scaled_range_is_the_same_experiment_as_the_wider_one(tmp_path):
    """20 % at scale 2 has the values of 40 %, and they share their trials."""
    scaled, wider = loaded(tmp_path, "{eps: +-20%, scale: 2}"), loaded(tmp_path, "{eps: +-40%}")
    assert scaled.hash == wider.hash
    values = [config.experiment.scenario.named_values(3)["eps"] for config in (scaled, wider)]
    assert values[0] == values[1] != 0


def test_what_is_written_loads_as_the_same_experiment(tmp_path):
    """The scale stands beside the laws as they were given."""
    config = loaded(tmp_path, "{eps: +-20%, scale: 1.5}")
    assert config.resolved["uncertainty"]["scale"] == 1.5
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    assert load_config(copy).hash == config.hash


def test_a_sweep_over_the_scale(tmp_path):
    """Runs of all points are paired; the written sweep loads as the same experiment."""
    config = loaded(tmp_path, "{eps: +-20%}", sweep="{grid: {uncertainty.scale: [0.5, 1, 2]}}")
    values = [point.experiment.scenario.named_values(0)["eps"] for point in config.points]
    np.testing.assert_allclose(values, np.array([0.5, 1, 2]) * values[1], **ROUND)
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(copy)
    assert [point.experiment.scenario.uncertainty for point in again.points] == [
        point.experiment.scenario.uncertainty for point in config.points
    ]


@pytest.mark.parametrize(
    ("uncertainty", "words"),
    [
        ("{eps: +-20%, scale: +-10%}", "choose another name for a quantity"),
        ("{eps: +-20%, scale: {dist: normal, std: 1}}", "choose another name for a quantity"),
        ("{eps: +-20%, scale: -1}", "a number >= 0 (got -1)"),
        ("{scale: 2}", "no uncertain quantity is named"),
    ],
)
def test_what_is_refused(tmp_path, uncertainty, words):
    """With the place of the key."""
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, uncertainty, plant=None if "eps" in uncertainty else "{kind: servo-linear}")
    (problem,) = caught.value.problems
    assert problem.path == "uncertainty.scale"
    assert words in problem.message


def test_the_scale_is_no_name_in_expressions(tmp_path):
    """It is not a quantity that a parameter may depend on."""
    with pytest.raises(ConfigError, match="unknown name 'scale'"):
        loaded(tmp_path, "{eps: +-20%, scale: 2}", plant="{kind: servo-linear, perturb: {J_l: 1 + scale}}")


TWO = "{kind: servo-linear, perturb: {J_l: exp(a), R: b}}"
COV = "[[0.04, 0.018], [0.018, 0.01]]"
NORMAL_GROUP = f"{{dist: normal, of: [a, b], mean: [0.1, 1], cov: {COV}}}"


def columns(config, n=20_000):
    """The quantities of many runs."""
    return config.experiment.scenario.named_columns(range(n))


@pytest.mark.parametrize(
    ("law", "mean", "variance"),
    [
        ("{dist: lognormal, median: 2, factor: 1.5}", 2.171347967, 2.171347967**2 * np.expm1(np.log(1.5) ** 2)),
        ("{dist: normal, std: 1, low: -0.5}", 0.509160434, 0.486175436),
        ("{dist: triangular, low: -1, mode: 0, high: 2}", 1 / 3, 7 / 18),
        (
            "{dist: choice, values: [1, 2, 4], probabilities: [0.5, 30%, 1/5]}",
            1.9,
            0.5 * 0.81 + 0.3 * 0.01 + 0.2 * 4.41,
        ),
    ],
)
def test_moments_of_the_draws_of_a_law(tmp_path, law, mean, variance):
    """Oracle: closed forms, within 5 standard errors; every draw depends on the run only, and the file loads again."""
    config = loaded(tmp_path, f"{{eps: {law}}}")
    eps = columns(config)["eps"]
    assert abs(eps.mean() - mean) < 5 * np.sqrt(variance / len(eps))
    spread = (eps - mean) ** 2
    assert abs(spread.mean() - variance) < 5 * spread.std() / np.sqrt(len(eps))
    assert [config.experiment.scenario.named_values(run)["eps"] for run in (3, 7)] == eps[[3, 7]].tolist()
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    assert load_config(copy).hash == config.hash


def test_a_group_of_correlated_quantities(tmp_path):
    """Oracle: mean and covariance within 5 standard errors; J_l depends on the draw; diagonal: single laws."""
    config = loaded(tmp_path, f"{{kinetics: {NORMAL_GROUP}}}", plant=TWO)
    found = columns(config)
    assert [*found] == ["a", "b"]
    mean, cov, n = np.array([0.1, 1.0]), np.array([[0.04, 0.018], [0.018, 0.01]]), 20_000
    e = np.array([found["a"], found["b"]]) - mean[:, None]
    assert (np.abs(e.mean(axis=1)) < 5 * np.sqrt(cov.diagonal() / n)).all()
    products = e[:, None] * e[None]
    assert (np.abs(products.mean(axis=-1) - cov) < 5 * products.std(axis=-1) / np.sqrt(n)).all()
    J_l = config.experiment.scenario.draw_delta(config.experiment.plant, range(3), 1)[-1]["J_l"]
    np.testing.assert_allclose(J_l / config.experiment.plant.nominal["J_l"], np.exp(found["a"][:3]), **ROUND)
    apart = loaded(
        tmp_path, "{a: {dist: normal, std: 0.2, mean: 0.1}, b: {dist: normal, std: 0.1, mean: 1}}", plant=TWO
    )
    together = NORMAL_GROUP.replace(COV, "[[0.04, 0], [0, 0.01]]")
    together = loaded(tmp_path, f"{{kinetics: {together}}}", plant=TWO)
    for name in ("a", "b"):
        np.testing.assert_allclose(columns(together, 9)[name], columns(apart, 9)[name], **ROUND)
    wider = loaded(tmp_path, f"{{kinetics: {NORMAL_GROUP}, scale: 2}}", plant=TWO)
    np.testing.assert_allclose(columns(wider, 9)["a"] - 0.1, 2 * (found["a"][:9] - 0.1), **ROUND)
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump(plain(wider.resolved)), encoding="utf-8")
    assert load_config(copy).hash == wider.hash != config.hash


@pytest.mark.parametrize(
    ("of", "values", "path", "words"),
    [
        ("[a, k]", "{file: p.csv}", "file", "p.csv has no column 'k'; there are a, b"),
        ("[a, b, c]", "{file: p.csv}", "file", "p.csv has no column 'c'; there are a, b"),
        ("3", "{file: p.csv}", "file", "p.csv has a, b; add `name`"),
        ("[a, b]", "{fil: p.csv}", "fil", "'fil' is not a known key; did you mean 'file'?"),
        ("[a, b]", "{file: p.csv, nam: a}", "nam", "'nam' is not a known key; did you mean 'name'?"),
        ("[a, b]", "{file: /etc/passwd}", "file", "must end in .mat, .npz, .csv"),
        ("[a, b]", "{name: a}", "file", "must end in .mat, .npz, .csv"),
    ],
)
def test_mistakes_of_a_file_with_rows(tmp_path, of, values, path, words):
    """Oracle: one mistake each, at the key."""
    (tmp_path / "p.csv").write_text("a,b\n1,2\n3,4\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, f"{{g: {{dist: choice, of: {of}, values: {values}}}}}", plant=TWO)
    [problem] = caught.value.problems
    assert problem.path == f"uncertainty.g.values.{path}" and problem.line > 1 and words in problem.message


@pytest.mark.parametrize("heading", ["", "b,c,a\n"])
def test_a_group_of_rows_of_a_file(tmp_path, heading):
    """Oracle: every run has one of the rows; columns are found by their names; numbers count for the identity."""
    rows = [(0.1, 9.0, 1.0), (0.2, 9.0, 2.0), (0.4, 9.0, 3.0)] if heading else [(1.0, 0.1), (2.0, 0.2), (3.0, 0.4)]
    text = heading + "".join(",".join(map(str, row)) + "\n" for row in rows)
    (tmp_path / "posterior.csv").write_text(text, encoding="utf-8")
    group = "{dist: choice, of: [a, b], values: {file: posterior.csv}}"
    config = loaded(tmp_path, f"{{kinetics: {group}}}", plant=TWO)
    found = columns(config, 3000)
    pairs, counts = np.unique(np.transpose([found["a"], found["b"]]), axis=0, return_counts=True)
    assert pairs.tolist() == [[1.0, 0.1], [2.0, 0.2], [3.0, 0.4]]
    assert (np.abs(counts - 1000) < 5 * np.sqrt(3000 * 2 / 9)).all()
    inline = group.replace("{file: posterior.csv}", "[[1, 0.1], [2, 0.2], [3, 0.4]]")
    assert loaded(tmp_path, f"{{kinetics: {inline}}}", plant=TWO).hash == config.hash


def test_a_group_is_stored_by_the_names_of_its_quantities(tmp_path):
    """Oracle: uncertainty.csv of a run has a column for every name, with the values of the scenario."""
    path = write(tmp_path, uncertainty=f"{{kinetics: {NORMAL_GROUP}}}", plant=TWO)
    ran(path, tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "uncertainty.csv")
    assert [*table] == ["run", "a", "b"]
    np.testing.assert_allclose(table["b"], columns(load_config(path), 6)["b"], rtol=1e-9)  # digits of the file


@pytest.mark.parametrize(
    ("uncertainty", "path", "words"),
    [
        ("{a: +-1%, g: {dist: normal, of: [a, b], mean: [0, 0], cov: [[1, 0], [0, 1]]}}", "g.of.0", "another quantity"),
        ("{g: {dist: normal, of: [b, a, b], mean: [0, 0, 0], cov: []}}", "g.of.2", "another quantity or group"),
        ("{a: {dist: normal, of: [a, b], mean: [0, 0], cov: [[1, 0], [0, 1]]}}", "a.of.0", "another quantity or group"),
        ("{g: {dist: normal, of: [a, b], mean: [0, 0], cov: [[1, 2], [2, 1]]}}", "g", "cov: must be positive semidef"),
        ("{g: {dist: normal, of: [a, exp], mean: [0, 0], cov: [[1, 0], [0, 1]]}}", "g.of.1", "'exp' is reserved"),
        (
            "{g: {dist: uniform, of: [a, b], low: 0, high: 1}}",
            "g.dist",
            "of several quantities; did you mean",
        ),
        ("{g: {dist: normal, of: a, mean: [0], cov: [[1]]}}", "g.of", "must be a list of names"),
        ("{a: {dist: choice, values: [1, 2], probabilities: [0.3, 0.3]}, b: 1%}", "a", "add to 0.6, not to 1"),
        ("{a: {dist: normal, std: 1, low: 2, high: 1}}", "a", "no value lies between low and high"),
        ("{a: {dist: triangular, low: 0, high: 1}}", "a", "'mode' is missing"),
        ("{a: {dist: lognormal, median: 2, factor: 0.5}}", "a.factor", "must be >= 1"),
        ("{log: +-1%}", "log", "'log' is reserved"),
    ],
)
def test_what_is_refused_of_further_laws(tmp_path, uncertainty, path, words):
    """With the place of the key."""
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, uncertainty, plant="{kind: servo-linear}")
    found = {problem.path: problem.message for problem in caught.value.problems}
    assert words in found[f"uncertainty.{path}"] and "your code" not in found[f"uncertainty.{path}"]


def test_earlier_laws_are_written_as_before(tmp_path):
    """Neither `low`, `high` nor `probabilities` stand where they are not given."""
    config = loaded(tmp_path, "{eps: {dist: normal, std: 0.1}, b: {dist: choice, values: [1, 2]}}")
    assert plain(config.resolved)["uncertainty"] == {
        "eps": {"dist": "normal", "std": 0.1, "mean": 0.0},
        "b": {"dist": "choice", "values": [1.0, 2.0]},
    }
