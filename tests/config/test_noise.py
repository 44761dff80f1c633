"""Sums of noise laws, `same` for a model with sets, laws of the initial state, and the set that it starts in."""

import numpy as np
import pytest
from conftest import EXACT, ROUND, STAT
from small_experiment import KEYS, cli, write
from uncertain_experiment import PLANT, write_estimation

from rmpc_bench import load_config, registry
from rmpc_bench.config.draft import SameLaw, SameOutliers
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.estimators import kalman
from rmpc_bench.noise.bounded import ellipsoid, uniform
from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.simulation.random_streams import stream
from rmpc_bench.types import ConfigError

G, E = "{gaussian: {cov: 0.25}}", "{ellipsoid: {shape: [4, 3, 2, 1], law: skewed-cube, outside: project}}"
SUM = f"{{sum: [{G}, {E}]}}"
START = "{sum: [{gaussian: {mean: [60, -45, 0, 0], cov: 100}}, {ellipsoid: {shape: 400}}]}"
LINEAR = "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], C: [[1, 0]], P_w: 0.25, M_w: [[5, 2], [2, 5]], P_v: 0.25, M_v: 5}"
TRUTH = PLANT.replace("Bw: [[1], [0.5]]", "Bw: 1").replace("H_A: [[0], [0.1]], G_x: [[1, 0]], ", "")
KALMAN = "{KF: {estimator: {kind: kalman}}}"


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the small experiment with some keys replaced."""
    return lambda **keys: load_config(write(tmp_path, **keys))


@pytest.fixture
def mixed(tmp_path):
    """Return a function that loads an estimation experiment with a model that has noise sets."""

    def load(**keys):
        keys = {"plant": TRUTH, "model": LINEAR, "methods": KALMAN, "initial": "{P: 1}"} | keys
        return load_config(write_estimation(tmp_path, **keys))

    return load


def test_terms_of_a_sum_have_streams_of_their_own(load):
    """Oracle: the laws and the streams w/0, w/1, v/0 and v/1 by hand, added up."""
    noise = f"{{process: {SUM}, measurement: {{sum: [{{gaussian: {{std: 0.1}}}}, {{uniform: {{radius: 1}}}}]}}}}"
    experiment = load(noise=noise).experiment
    drawn = experiment.scenario.draw(experiment.plant, range(3, 5), 10)
    cube = ellipsoid(4, shape=[4.0, 3.0, 2.0, 1.0], law="skewed-cube", outside="project")
    channels = {"w": (gaussian(4, cov=0.25), cube), "v": (gaussian(1, std=0.1), uniform(1, radius=1.0))}
    for row, run in enumerate((3, 4)):
        for name, laws in channels.items():
            one, two = (law.draw(stream(7, run, f"{name}/{number}"), 11) for number, law in enumerate(laws))
            np.testing.assert_array_equal(getattr(drawn, name)[row], one + two)


@pytest.mark.parametrize("law", [G, "same", "{ellipsoid: {shape: 2}}"])
def test_a_sum_of_one_is_that_one(load, law):
    """Oracle: the configuration without the sum: the same data, the same hash."""
    bare, alone = load(noise=f"{{process: {law}}}"), load(noise=f"{{process: {{sum: [{law}]}}}}")
    assert bare.resolved == alone.resolved and bare.hash == alone.hash


def test_every_word_of_a_sum_is_in_the_hash(load):
    """Order, place, parameters and number of the terms."""
    laws = [SUM, f"{{sum: [{E}, {G}]}}", SUM.replace("0.25", "0.26"), f"{{sum: [{G}, {G}, {E}]}}", G, E]
    laws += [SUM.replace("project", outside) for outside in ("keep", "reject")]
    configs = [load(noise=f"{{process: {law}}}") for law in laws] + [load(initial=f"{{x: {SUM}}}")]
    assert len({config.hash for config in configs}) == len(laws) + 1
    explicit = E.replace("shape", "root: symmetric, center: 0, skew: 90%, scale: 1, shape")
    assert load(noise=f"{{process: {{sum: [{G}, {explicit}]}}}}").hash == configs[0].hash


@pytest.mark.parametrize(
    "keys",
    [
        {"noise": f"{{process: {SUM}, measurement: {{uniform: {{radius: sqrt(5)}}}}}}"},
        {"noise": f"{{process: {{sum: [same, {{same: {{scale: 1/3}}}}, {E}]}}}}"},
        {"initial": f"{{x: {START}, x_hat: [60, -45, 0, 0], P: 100, M: 400}}"},
        {"initial": f"{{x: {SUM}, M: [1, 2, 3, 1/3]}}"},
    ],
)
def test_sums_and_sets_are_written_back(load, tmp_path, keys):
    """Oracle: what is written loads to the same data and the same hashes."""
    config = load(**keys)
    copy = tmp_path / "config.resolved.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(copy)
    assert again.resolved == config.resolved
    assert (again.hash, again.full_hash) == (config.hash, config.full_hash)


def test_terms_can_be_swept_and_overridden(tmp_path):
    """A step into a list is a number; the other terms keep their streams."""
    path = write(tmp_path, noise=f"{{process: {SUM}}}", sweep="{grid: {noise.process.sum.1.ellipsoid.scale: [0, 1]}}")
    silent, loud = (point.experiment for point in load_config(path).points)
    one, two = (each.scenario.draw(each.plant, range(2), 5).w for each in (silent, loud))
    first = gaussian(4, cov=0.25).draw(stream(7, 1, "w/0"), 6)
    np.testing.assert_array_equal(one[1], first)
    assert (two != one).any()
    config = load_config(path, overrides=["noise.process.sum.0.gaussian.cov=9"])
    assert config.points[0].shared["noise"]["process"]["sum"][0]["gaussian"]["cov"] == 9.0


def test_same_of_a_model_with_sets(mixed):
    """Oracle: its stochastic noise and a uniform one in its set, with the streams 0 and 1; the scale goes for both."""
    scenario = mixed(noise="{process: {same: {scale: 2}}, measurement: same}").experiment.scenario
    normal, bounded = scenario.process
    np.testing.assert_allclose(normal.cov, np.eye(2), **ROUND)
    np.testing.assert_allclose(bounded.cov, np.array([[5.0, 2.0], [2.0, 5.0]]), **ROUND)  # 2^2 M / (n + 2)
    assert [term.cov.item() for term in scenario.measurement] == pytest.approx([0.25, 5 / 3], rel=1e-12)  # ROUND
    drawn = scenario.draw(mixed().experiment.plant, range(1), 4)
    laws = gaussian(1, cov=0.25), ellipsoid(1, shape=5.0)
    one, two = (law.draw(stream(7, 0, f"v/{number}"), 5) for number, law in enumerate(laws))
    np.testing.assert_array_equal(drawn.v[0], one + two)


def test_same_without_a_set_is_one_law(mixed, load):
    """Oracle: an empty set adds no term; nor does any other model's noise have two."""
    scenario = mixed(noise="same", model=LINEAR.replace("M_v: 5", "M_v: 0")).experiment.scenario
    assert [len(scenario.process), len(scenario.measurement)] == [2, 1]
    scenario = load(noise="same", initial="{x: {same: {}}}").experiment.scenario
    assert [len(scenario.process), len(scenario.measurement), len(scenario.x0_noise)] == [1, 1, 1]


def test_the_start_has_the_spread_of_the_stochastic_noise(mixed):
    """Oracle: `x: same` belongs to `P: process`, the set to M."""
    [law] = mixed(initial="{x: {same: {scale: 2}}}").experiment.scenario.x0_noise
    np.testing.assert_allclose(law.cov, np.eye(2), **ROUND)


def test_same_is_one_law_at_all_k(mixed):
    """A law that changes over time cannot be the noise of every k; matrices that are not its own may change."""
    for key, name, text in (
        ("P_w", "process", "P_w: [1 + k, 1]"), ("M_v", "measurement", "M_v: [5 + k]"),
    ):  # fmt: skip
        model = LINEAR.replace({"P_w": "P_w: 0.25", "M_v": "M_v: 5"}[key], text)
        with pytest.raises(ConfigError) as caught:
            mixed(model=model)
        [problem] = caught.value.problems
        assert problem.path == "noise"
        assert (
            problem.message
            == f"'same' must be one law at all k, but the {name} noise of the design model changes with k"
        )
    assert mixed(model=LINEAR.replace("0.7", "0.7 + 0*k")).experiment.scenario.process


def test_initial_state_by_a_sum_of_laws(load):
    """Oracle: the streams x0 and x0/1 by hand; mean and covariance of a normal and a uniform law."""
    experiment = load(initial=f"{{x: {START}}}").experiment
    laws = gaussian(4, mean=[60.0, -45.0, 0.0, 0.0], cov=100.0), ellipsoid(4, shape=400.0)
    for run, x0 in enumerate(experiment.scenario.draw(experiment.plant, range(3), 2).x0):
        one, two = (law.draw(stream(7, run, name), 1)[0] for law, name in zip(laws, ("x0", "x0/1"), strict=True))
        np.testing.assert_array_equal(x0, one + two)
    mean, cov = experiment.scenario.initial_law()
    np.testing.assert_array_equal(mean, [60.0, -45.0, 0.0, 0.0])
    np.testing.assert_allclose(cov, (100.0 + 400.0 / 6.0) * np.eye(4), **ROUND)


@pytest.fixture
def received(monkeypatch):
    """Return what a registered estimator `curious` is given as M0."""
    seen = []

    def design(model, n_steps, *, x0, P0, M0):
        seen.append(M0)
        return kalman.design(model, n_steps, x0=x0, P0=P0)

    monkeypatch.setitem(registry._REGISTERED["estimators"], "curious", design)
    return seen


@pytest.mark.parametrize(
    ("M", "expected"),
    [("400", 400 * np.eye(4)), ("[1, 2, 3, 0]", np.diag([1.0, 2.0, 3.0, 0.0])), (None, 0 * np.eye(4))],
)
def test_estimators_that_take_it_get_the_set(load, received, M, expected):
    """Oracle: a number is times the identity, a list a diagonal; zero unless given; it is no key."""
    config = load(initial="{}" if M is None else f"{{M: {M}}}", methods="{a: {estimator: {kind: curious}}}")
    np.testing.assert_array_equal(received, [expected])
    assert config.methods["a"]["estimator"] == {"kind": "curious"}


def test_a_set_that_is_zero_changes_no_key(load):
    """Oracle: trials from before there were sets are still those of their methods; another set is another method."""
    plain_, zero, set_ = load(), load(initial="{x: 0, x_hat: 0, P: process, M: 0}"), load(initial="{M: 2}")
    assert zero.resolved == plain_.resolved and zero.full_hash == plain_.full_hash
    assert "M" not in plain_.methods["S-MPC"] and "M" not in plain_.resolved["initial"]
    assert set_.hash == plain_.hash and set_.full_hash != plain_.full_hash
    assert set_.points[0].method_keys["S-MPC"] != plain_.points[0].method_keys["S-MPC"]


MISTAKES = [
    # key, its value, the text whose place is shown, path, message
    ("noise", "{process: {sum: []}}", "[]", "noise.process.sum", "must be a list of laws (got a list of 0)"),
    ("noise", f"{{process: {{sum: {G}}}}}", G, "noise.process.sum", "must be a list of laws (got a mapping)"),
    ("noise", "{process: sum}", "sum", "noise.process", "'sum' needs its terms"),
    ("noise", "{process: {sum: [same, none]}}", "none", "noise.process.sum.1", "'none' adds nothing"),
    ("noise", f"{{process: {{sum: [{G}, {{sum: []}}]}}}}", "{sum: []", "noise.process.sum.1", "a sum inside a sum"),
    ("noise", "{process: {sum: [same, gaussian]}}", "gau", "noise.process.sum.1", "'gaussian' needs its parameters"),
    ("noise", "{process: {sum: [same, {ellipsoud: {}}]}}", "{ell", "noise.process.sum.1", "did you mean 'ellipsoid'?"),
    ("noise", "{process: {sum: [same, 3]}}", "3", "noise.process.sum.1", "a number is no noise law"),
    ("noise", "{process: {sum: [same, {same: {scale: -1}}]}}", "-1", "noise.process.sum.1.same.scale", "must be >= 0"),
    ("noise", "{process: {gaussian: {std: 1}, same: {}}}", "{gau", "noise.process", "laws add up as a list: {sum: ["),
    ("noise", f"{{measurement: [same, {G}]}}", "[same", "noise.measurement", "a list of laws is written {sum: [..]}"),
    ("noise", f"[same, {G}]", "[same", "noise", "a list of laws is written {sum: [..]}"),
    ("noise", "{process: {none: {}}}", "{none", "noise.process", "'none' is not a known noise law; known: same, sum"),
    ("noise", f"{{process: {{sum: [{G}, {{uniform: {{radius: [1, -1]}}}}]}}}}", "-1",
     "noise.process.sum.1.uniform.radius.1", "must be >= 0 (got -1)"),
    ("noise", "{process: {uniform: {radius: [1, 1]}}}", "[1, 1]", "noise.process.uniform.radius", "4 numbers"),
    ("noise", "{measurement: {ellipsoid: {shape: -1}}}", "-1", "noise.measurement.ellipsoid.shape", "semidefinite"),
    ("noise", "{process: {ellipsoid: {shape: [1, 1]}}}", "[1, 1]", "noise.process.ellipsoid.shape", "4 x 4 numbers"),
    ("noise", "{process: {ellipsoid: {}}}", "{}", "noise.process.ellipsoid", "'shape' is missing"),
    ("noise", "{process: {ellipsoid: {shape: 0, root: lower}}}", "lower", "noise.process.ellipsoid.root", "singular"),
    ("noise", "{process: {ellipsoid: {shape: 0, root: middle}}}", "middle", "noise.process.ellipsoid.root", "'lower'"),
    ("noise", "{process: {ellipsoid: {shape: 1, outside: keep, law: skewed-cube, skew: 2}}}", "2",
     "noise.process.ellipsoid.skew", "must be <= 1 (got 2)"),
    ("noise", "{process: {ellipsoid: {shape: 1, outside: reject}}}", "reject", "noise.process.ellipsoid.outside",
     "can only be given with law: skewed-cube"),
    ("initial", f"{{x: {{sum: [{G}, {{ellipsoid: {{shape: [1]}}}}]}}}}", "[1]", "initial.x.sum.1.ellipsoid.shape",
     "4 x 4 numbers"),
    ("initial", "{M: -1}", "-1", "initial.M", "must be positive semidefinite (smallest eigenvalue -1)"),
    ("initial", "{M: [1, 2]}", "[1, 2]", "initial.M", "a number, 4 numbers or 4 x 4 numbers are required"),
    ("initial", "{M: process}", "process", "initial.M", "unknown name 'process'"),
]  # fmt: skip


@pytest.mark.parametrize(("key", "value", "text", "path", "message"), MISTAKES, ids=[case[1] for case in MISTAKES])
def test_one_mistake_is_reported_once_at_its_place(load, key, value, text, path, message):
    """Line, column, key path and reason; nothing that only follows from it."""
    with pytest.raises(ConfigError) as caught:
        load(**{key: value})
    [problem] = caught.value.problems
    place = [*KEYS].index(key) + 1, len(key) + 3 + value.rindex(text)
    assert (problem.line, problem.column, problem.path) == (*place, path)
    assert message in problem.message


def test_a_cross_covariance_needs_normal_noises(mixed):
    """A sum has no cross-covariance with anything."""
    with pytest.raises(ConfigError, match="one gaussian law for the process"):
        mixed(noise="{process: same, measurement: same, cross: [[0.1], [0]]}")


PREDICTOR = "{KF: {estimator: {kind: kalman-predictor}}}"


@pytest.mark.parametrize(
    ("outside", "where"), [("keep", None), ("reject", None), ("project", "process"), ("project", "start")]
)
def test_exact_moments_need_laws_that_tell_theirs(mixed, outside, where):
    """Oracle: the laws of the bench; where the moments of one are not known, the place and the reason."""
    cube = f"{{sum: [{{gaussian: {{cov: 1}}}}, {{ellipsoid: {{shape: 1, law: skewed-cube, outside: {outside}}}}}]}}"
    keys = {"noise": f"{{process: {cube}}}"} if where != "start" else {"noise": "none", "initial": f"{{x: {cube}}}"}
    keys |= {"evaluate": "moments", "model": "{from: plant, W: 1, V: 1}", "methods": PREDICTOR}
    if where is None:
        assert mixed(**keys).experiment.scenario.noise_laws(2, 1) is not None
        return
    with pytest.raises(ConfigError) as caught:
        mixed(**keys)
    [problem] = caught.value.problems
    assert problem.path == "evaluate"
    reason = f"the moments of a law of {'the initial state' if where == 'start' else 'noise'} are not known"
    assert problem.message == f"KF has no exact moments: {reason}; evaluate: [runs, moments]"


def test_check_shows_every_term(tmp_path):
    """One line for each, the set beside the covariance; without a sum one line as ever."""
    path = write(tmp_path, noise=f"{{process: {SUM}, measurement: {G}}}", initial=f"{{x: {START}, P: 100, M: 400}}")
    noise = "noise plant: process gaussian: {mean: 0.0, cov: 0.25, scale: 1.0} + ellipsoid: shape: [4.0, 3.0, 2.0, 1.0]"
    assert noise in " ".join(cli("check", path).stdout.split())
    rows = cli("check", path, "--full").stdout.partition("design model\n")[2].splitlines()
    first, second, third = (
        next(k for k, row in enumerate(rows) if row.startswith(f" {name} ")) for name in ("noise", "initial", "kind")
    )
    assert third < first < second
    assert "process = gaussian:" in rows[first] and rows[first].endswith("process: 1.0 measurement: 1.0")
    assert any("+ ellipsoid: shape:" in row for row in rows[first:second])
    assert any("measurement = gaussian:" in row for row in rows[first:second])
    assert "x = gaussian:" in rows[second] and any("+ ellipsoid:" in row for row in rows[second:])
    shown = cli("check", write(tmp_path), "--full").stdout
    assert "process = none" in shown and "measurement = gaussian" in shown and "x_hat = 0.0, P = process" in shown


@pytest.mark.parametrize("kind", ["ellipsoid", "uniform"])
def test_describe_shows_every_parameter(kind):
    """Oracle: the keys of the design, each with its meaning."""
    shown = cli("describe", f"noises/{kind}").stdout
    parameters = ["radius", "center"] if kind == "uniform" else "shape law root outside center skew scale".split()
    for name in parameters:
        assert f"\n  {name}  (" in shown
    assert "{sum: [" in shown


def test_describe_of_a_configuration_shows_the_terms(tmp_path):
    """A sum is a list there too."""
    shown = cli("describe", write(tmp_path, noise=f"{{process: {SUM}}}", initial=f"{{x: {START}}}")).stdout
    assert shown.count("sum:") == 2 and "- {gaussian: {mean: 0.0, cov: 0.25, scale: 1.0}}" in shown


COV = np.array([[4.0, 1.0], [1.0, 9.0]])
MEAN = np.array([1.0, -2.0])
MODEL = "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], C: [[1, 0]], P_w: [[4, 1], [1, 9]], P_v: 0.25, w_mean: [1, -2]}"
TWO_STATES = "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], C: [[1, 0]]}"


@pytest.fixture
def load_same(tmp_path):
    """Return a function that loads an estimation experiment with a law of the process noise."""

    def make(law, **keys):
        keys = {
            "plant": TWO_STATES,
            "model": MODEL,
            "methods": "{KF: {estimator: {kind: kalman}}}",
            "initial": "{P: 1}",
        } | keys
        return load_config(write_estimation(tmp_path, noise=f"{{process: {law}, measurement: same}}", **keys))

    return make


def drawn(config, runs=400, steps=50):
    """Return the process noise of some runs, (runs * steps, 2)."""
    experiment = config.experiment
    return experiment.scenario.draw(experiment.plant, range(runs), steps).w.reshape(-1, 2)


@pytest.mark.parametrize(
    ("law", "mean", "cov"),
    [
        (SameLaw(), MEAN, COV),
        (SameLaw(scale=3.0), MEAN, 9 * COV),
        (SameLaw(bias=0.5), MEAN + [1.0, 1.5], COV),
        (SameLaw(scale=2.0, bias=-1.0), MEAN - [4.0, 6.0], 4 * COV),
        (SameLaw(outliers=SameOutliers(0.05, 10.0)), MEAN, (0.95 + 0.05 * 100) * COV),
        (SameLaw(dof=3.0), MEAN, COV),
        (SameLaw(dof=5.0, scale=2.0, bias=1.0), MEAN + [4.0, 6.0], 4 * COV),
    ],
)
def test_moments(law, mean, cov):
    """Oracle: closed forms.  Student's t has the covariance of the model, outliers have a larger one."""
    noise = law.noise(MEAN, COV)
    np.testing.assert_allclose(noise.mean, mean, **ROUND)
    np.testing.assert_allclose(noise.cov, cov, **ROUND)


def test_sample_of_a_configuration(load_same):
    """From the YAML to the numbers: share of outliers and mean, within STAT standard errors."""
    clean = drawn(load_same("same"))
    bad = drawn(load_same("{same: {outliers: {probability: 5%, factor: 10}, bias: 0.5}}"))
    shift = np.array([1.0, 1.5])
    hit = np.abs((bad - MEAN - shift) - (clean - MEAN)).max(axis=1) > 1e-9
    share = hit.mean()
    assert abs(share - 0.05) < STAT * np.sqrt(0.05 * 0.95 / len(bad))
    # The other samples are those of `same`, shifted.
    np.testing.assert_allclose((bad - shift)[~hit], clean[~hit], rtol=0, atol=1e-12)  # of numbers up to 15
    np.testing.assert_allclose((bad - shift - MEAN)[hit], 10 * (clean - MEAN)[hit], **ROUND, atol=1e-11)


def test_nothing_changes_without_a_key(load_same):
    """The short form, an empty mapping and keys at their defaults are one law with one hash."""
    configs = [load_same(law) for law in ("same", "{same: {}}", "{same: {scale: 1, bias: 0}}")]
    assert len({config.hash for config in configs}) == 1
    assert configs[0].first_point["noise"]["process"] == {"same": {"scale": 1.0}}
    np.testing.assert_allclose(drawn(configs[0]), drawn(configs[2]), **EXACT)


def test_departures_are_in_the_hash_and_in_the_resolved_file(load_same, tmp_path):
    """And the resolved file loads as the same experiment."""
    from rmpc_bench.config_file.yaml import dump

    configs = [
        load_same(f"{{same: {{{keys}}}}}") for keys in ("bias: 1", "dof: 4", "outliers: {probability: 0.1, factor: 5}")
    ]
    assert len({config.hash for config in [*configs, load_same("same")]}) == 4
    for number, config in enumerate(configs):
        file = tmp_path / f"resolved-{number}.yaml"
        file.write_text(dump(config.resolved))
        assert load_config(file).hash == config.hash


@pytest.mark.parametrize(
    ("law", "where", "message"),
    [
        ("{same: {dof: 2}}", "noise.process.same.dof", "must be > 2"),
        ("{same: {dof: 3, outliers: {probability: 0.1, factor: 2}}}", "noise.process.same", "give outliers or dof"),
        ("{same: {outliers: {probability: 2, factor: 2}}}", "noise.process.same.outliers.probability", "must be <= 1"),
        ("{same: {outliers: {probability: 0.1}}}", "noise.process.same.outliers", "factor"),
        ("{same: {bais: 1}}", "noise.process.same", "bais"),
    ],
)
def test_mistakes(load_same, law, where, message):
    """Each is reported at its place."""
    with pytest.raises(ConfigError) as caught:
        load_same(law)
    assert where in str(caught.value) and message in str(caught.value)
