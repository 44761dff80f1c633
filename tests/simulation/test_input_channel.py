"""The channel `noise.input`: what acts, what methods know of it, records, determinism and refusals."""

import numpy as np
import pytest
from conftest import ROUND, within_stat
from small_experiment import cli, ran

from rmpc_bench import load_config, single_run
from rmpc_bench.conformance.subject import subject_of
from rmpc_bench.simulation.closed_loop import simulate, simulate_block
from rmpc_bench.simulation.episode import Episode
from rmpc_bench.simulation.input_channel import InputChannel, newest
from rmpc_bench.simulation.linear_loop import applies
from rmpc_bench.types import Command, ConfigError, Controller, Estimate, Estimator, Journal, KnownDelay, RunInfo

N = 40
TEXT = """
version: 1
name: channel
seed: 4
runs: 6
time: {step: 0.1, steps: 40}
plant: {ode: m.py:rhs, output: m.py:out, states: [a, b], inputs: [f, g], outputs: [h], discrete: true@PLANT}
model: {linearise: plant, at: {x: @XOP, u: @UOP}, noise: {process: [1e-5, 1e-3], measurement: 4e-3}@MODEL}
noise: {process: {gaussian: {cov: [1e-5, 1e-3]}}, measurement: {gaussian: {cov: 4e-3}}, input: @INPUT}
reference: {kind: constant, value: 0}
estimator: {kind: kalman}
controller: {kind: control-lqr, Q_x: [1, 0.1], R_u: 0.1}
methods: @METHODS
metrics: [mse, input_power, estimation_mse, {kind: largest, of: f}, {kind: largest, name: sent, of: u_command.0}]
record: {runs: all, signals: [y, u, u_command, x, x_hat]}
"""
CODE = """
def rhs(x, u, p):
    return [x[0] + 0.1 * x[1] + 0.005 * u[0], 0.98 * x[1] + 0.1 * u[0] + 0.05 * u[1]]

def out(x, p):
    return [x[0]]
"""


def write(directory, law="none", **keys):
    """Write the configuration with these laws of the input; other keys replace words of the text."""
    (directory / "m.py").write_text(CODE)
    given = {"INPUT": law, "PLANT": "", "MODEL": "", "UOP": "[0, 0]", "XOP": "[0, 0]", "METHODS": "{K: {}}"} | keys
    text = TEXT
    for name, value in given.items():
        text = text.replace(f"@{name}", value)
    path = directory / "channel.yaml"
    path.write_text(text)
    return path


def load(directory, law="none", **keys):
    return load_config(write(directory, law, **keys)).experiment


def test_the_newest_command_that_has_arrived_acts(rng):
    """Oracle: the definition, sample by sample; an older command never replaces a newer one."""
    d = rng.integers(0, 6, (4, 30, 2))
    found = newest(d)
    for row, k, i in np.ndindex(d.shape):
        assert found[row, k, i] == max([j for j in range(k + 1) if j + d[row, j, i] <= k], default=-1)
    assert (np.diff(found, axis=1) >= 0).all() and (found == -1).any()


LAWS = (
    "{sum: [{gaussian: {std: [0.1, 0.2]}}, {quantised: {step: 0.25}}, {missing: {probability: 30%, outputs: each}}, "
    "{delayed: [0, 3]}, {missing: {probability: 20%, known: false}}, {missing: {every: 3, first: 2, only: [g]}}]}"
)


def replayed(laws, u_c, delay, low, high, role):
    """Replay the laws one after the other: `acts`, `known`, or `sent` for what a law is told; element by element."""
    n_runs, n, nu = u_c.shape
    found, delayed = u_c.copy(), False
    for name, drawn in laws:
        before = found.copy()
        for row, i in np.ndindex(n_runs, nu):
            last = 0.0
            for k in range(n):
                now = before[row, k, i]
                if name == "gaussian":
                    now = now + drawn[row, k, i] if role == "acts" else now
                elif name == "quantised":
                    now = 0.25 * np.round(now / 0.25)
                elif name == "delayed":
                    late = drawn[row, :, i] if role == "acts" else np.full(n, delay)
                    j = max([j for j in range(k + 1) if j + late[j] <= k], default=None)
                    now = now if role == "sent" else 0.0 if j is None else before[row, j, i]
                elif name == "known" and drawn[row, k, i] and not (role == "sent" and delayed and delay):
                    now = last
                elif name == "unknown" and drawn[row, k, i] and role == "acts":
                    now = last
                last = now
                found[row, k, i] = now
        delayed = delayed or name == "delayed"
    return np.clip(found, low, high)


@pytest.mark.parametrize("delay", [0, 2])
def test_laws_act_in_their_order(tmp_path, rng, delay):
    """Oracle: a replay of the definitions, law by law, of what acts, what is known, and what a law is told."""
    experiment = load(tmp_path, LAWS, PLANT=", bounds: {f: [-1, 1]}", MODEL=f", delay: {{input: {delay}}}")
    plant, u_c = experiment.plant, rng.standard_normal((6, N, 2))
    draws = experiment.scenario.draw(plant, range(6), N)
    runs = RunInfo(tuple(range(6)), (), np.ones(6, bool), Journal())
    channel = InputChannel(plant, draws.inputs, experiment.methods[0].delay, (), runs)
    steps = [channel.step(k, u_c[:, k].copy()) for k in range(N)]
    names = ("gaussian", "quantised", "known", "delayed", "unknown", "known")
    laws = [(name, each.drawn) for name, each in zip(names, draws.inputs, strict=True)]
    low, high = np.array([-1.0, -np.inf]), np.array([1.0, np.inf])
    for role, field in (("acts", "u"), ("known", "known"), ("sent", "sent")):
        found = np.stack([getattr(step, field) for step in steps], axis=1)
        np.testing.assert_allclose(found, replayed(laws, u_c, delay, low, high, role), **ROUND, atol=1e-15)
    beyond = np.abs(replayed(laws, u_c, delay, -np.inf, np.inf, "acts")[..., 0]) > 1.0
    assert runs.journal.warnings["input f limited to [-1, 1]"] == beyond.sum() > 0


class Seen(Estimator):
    """Keeps the inputs that it gets."""

    def __init__(self):
        self.u = []

    def init(self, n_runs):
        return None

    def correct(self, k, state, y):
        return state, Estimate(np.zeros((len(y), 2)), None, None, np.zeros(len(y), np.int8), {})

    def predict(self, k, state, u):
        self.u.append(u.copy())
        u[:] = np.nan  # its own copy
        return state


class Sends(Controller):
    """Sends given inputs and keeps what becomes of them."""

    uses_estimate = False

    def __init__(self, u):
        self.sent, self.told = u, []

    def init(self, n_runs):
        return None

    def control(self, k, state, y, estimate, r):
        return state, Command(self.sent[:, k])

    def applied(self, k, state, u):
        self.told.append(u.copy())
        return state


@pytest.mark.parametrize("delay", [0, 2])
def test_filters_laws_and_records_get_their_inputs(tmp_path, rng, delay):
    """Oracle: the channel by itself; the record has what acts and what was sent."""
    experiment = load(tmp_path, LAWS, MODEL=", delay: none")
    plant, known = experiment.plant, KnownDelay(delay)
    u_c = rng.standard_normal((6, N, 2))
    filter_, law = Seen(), Sends(u_c)
    method = experiment.methods[0]._replace(estimator=filter_, controller=law, delay=known)
    draws = experiment.scenario.draw(plant, range(6), N)
    record, status = simulate(plant, method, draws, np.zeros((N + 4, 1)), N)
    assert not status.any()
    runs = RunInfo(tuple(range(6)), (), np.ones(6, bool), Journal())
    channel = InputChannel(plant, draws.inputs, known, (), runs)
    for k in range(N):
        step = channel.step(k, u_c[:, k])
        np.testing.assert_array_equal(record.u[:, k], step.u)
        np.testing.assert_array_equal(filter_.u[k], step.known)
        np.testing.assert_array_equal(law.told[k], step.sent)
    np.testing.assert_array_equal(record.u_command, u_c)


def test_own_components_get_what_is_known_of_the_acting_input(tmp_path):
    """`u_previous` has the delay; x_hat and r of a law are those of the sample where its input acts."""
    seen = {"law": [], "filter": [], "x_hat": [], "r": [], "k": []}

    @single_run
    class Law:
        def control(self, x_hat, r, u_previous, k):
            for name, value in (("law", u_previous), ("x_hat", x_hat), ("r", r), ("k", k)):
                seen[name].append(value)
            return np.array([k + 1.0, 0.0])

    @single_run
    class Filter:
        def update(self, y, u_previous):
            seen["filter"].append(u_previous)
            return np.array([1.0, 2.0])

    experiment = load(tmp_path, "{delayed: 3}", MODEL=", delay: same")
    method, model = experiment.methods[0], experiment.methods[0].flow.model
    provided = {"model": model, "Ts": 0.1, "n_steps": N, "x0": np.zeros(2), "P0": np.eye(2), "M0": np.eye(2)}
    law, filter_ = (
        subject_of(each, group).made(group, provided) for each, group in ((Law, "controllers"), (Filter, "estimators"))
    )
    method = method._replace(estimator=filter_, controller=law)
    draws = experiment.scenario.draw(experiment.plant, range(1), N)
    r = np.arange(N + 5.0)[:, None]
    record, status = simulate(experiment.plant, method, draws, r, N)
    assert not status.any() and method.delay.input == 3 and method.preview == 4
    acting = [0.0, 0.0, 0.0, *np.arange(1.0, N - 2)]
    np.testing.assert_array_equal(record.u[0, :, 0], acting)
    for name, values in (("law", seen["law"][1:]), ("filter", seen["filter"][1:])):
        np.testing.assert_array_equal(np.array(values)[: N - 1, 0], acting[: N - 1], err_msg=name)
    np.testing.assert_array_equal(np.ravel(seen["r"]), r[3 : N + 3, 0])
    assert seen["k"] == [*range(N)]
    x = np.array([1.0, 2.0])
    for u in (5.0, 6.0, 7.0):  # on the way at k = 7
        x = model.A @ x + model.B @ np.array([u, 0.0])
    np.testing.assert_allclose(seen["x_hat"][7], x, **ROUND)
    np.testing.assert_array_equal(record.x_hat[0], np.tile([1.0, 2.0], (N + 1, 1)))


def test_before_the_first_command_the_input_of_the_operating_point_acts(tmp_path):
    """Oracle: the key `at` of the model, for the plant, the filter and the prediction of the law; else 0."""
    experiment = load(tmp_path, "{delayed: 2}", UOP="[0, 0]")
    assert experiment.methods[0].u_before == (0.0, 0.0)
    at = "[0.5, -1.01]"  # steady with b = -0.05 f and g = -2.02 f
    keys = {"UOP": at, "XOP": "[0, -0.025]"}
    keys["METHODS"] = "{K: {controller: {kind: lqr, horizon: 5, Q_x: 1, R_u: 1}}}"
    experiment = load(tmp_path, "{sum: [{delayed: 2}, {missing: {every: 4, first: 3}}]}", **keys)
    traces = simulate_block(experiment, experiment.methods[0], range(2)).traces
    np.testing.assert_array_equal(traces["u"][:, :3], np.tile([0.5, -1.01], (2, 3, 1)))
    for k in range(3, N):
        np.testing.assert_array_equal(traces["u"][:, k], traces["u_command"][:, (k - 3) // 4 * 4 + 1])


def test_a_delay_of_0_is_none(tmp_path):
    """Oracle: the same experiment without the channel and without the key, bit for bit."""
    expected, found = (
        simulate_block(load(tmp_path, law, MODEL=model), load(tmp_path, law, MODEL=model).methods[0], range(6))
        for law, model in (("none", ""), ("{sum: [{delayed: 0}, {delayed: [0, 0]}]}", ", delay: {input: 0}"))
    )
    np.testing.assert_array_equal(found.metrics, expected.metrics)
    for signal, values in expected.traces.items():
        np.testing.assert_array_equal(found.traces[signal], values)


RANDOM = "{sum: [{delayed: [0, 3]}, {delayed: {samples: [0, 2], per: run, only: [f]}}, {missing: {probability: 20%}}]}"


@pytest.mark.long
def test_random_delays_depend_on_the_run_only(tmp_path):
    """Oracle: the blocks of all runs and of single ones, and one worker and two, bit for bit."""
    keys = {"MODEL": ", delay: {input: 1}", "METHODS": "{K: {}, N: {model: {delay: none}}}"}
    path = write(tmp_path, RANDOM, **keys)
    experiment = load_config(path).experiment
    for method in experiment.methods:
        whole = simulate_block(experiment, method, range(6)).metrics
        parts = [simulate_block(experiment, method, range(i, i + 1)).metrics for i in range(6)]
        np.testing.assert_array_equal(whole, np.hstack(parts))
    assert ran(path, tmp_path / "one") == ran(path, tmp_path / "two", jobs=2)


def test_a_delay_per_run_is_constant_over_the_run(tmp_path):
    """Oracle: the command shifted by the delay of the run; runs differ."""
    experiment = load(tmp_path, "{delayed: {samples: [0, 4], per: run}}", MODEL=", delay: {input: 2}")
    traces = simulate_block(experiment, experiment.methods[0], range(6)).traces
    shifts = set()
    for u, sent in zip(traces["u"], traces["u_command"], strict=True):
        [d] = [d for d in range(5) if np.array_equal(u[d:], sent[: N - d]) and not u[:d].any()]
        shifts.add(d)
    assert len(shifts) > 1


def test_metrics_have_the_input_that_acts(tmp_path):
    """Oracle: the recorded signals; x_hat and its metrics are those of k."""
    experiment = load(tmp_path, "{sum: [{delayed: 2}, {quantised: {step: 0.01}}]}")
    block = simulate_block(experiment, experiment.methods[0], range(6))
    values = dict(zip([metric.name for metric in experiment.metrics], block.metrics, strict=True))
    u, sent, e = block.traces["u"], block.traces["u_command"], block.traces["x_hat"] - block.traces["x"]
    np.testing.assert_allclose(values["input_power"], (u**2).mean(axis=(1, 2)), **ROUND)
    np.testing.assert_allclose(values["largest"], np.abs(u[..., 0]).max(axis=1), **ROUND)
    np.testing.assert_allclose(values["sent"], np.abs(sent[..., 0]).max(axis=1), **ROUND)
    np.testing.assert_allclose(values["estimation_mse"], (e[:, :N] ** 2).mean(axis=(1, 2)), **ROUND)
    np.testing.assert_allclose(u[:, 2:], 0.01 * np.rint(sent[:, :-2] / 0.01), **ROUND, atol=1e-15)


def test_limits_of_the_plant_reach_predictions(tmp_path):
    """What is on the way to a filter and a law is within the bounds.  Oracle: without noise the filter is exact."""
    law = "{K: {controller: {kind: mpc, Hp: 10, Hu: 3, Q: 1, R: 1e-4}}}"
    path = write(tmp_path, "{delayed: 2}", PLANT=", bounds: {f: [-0.4, 0.4], g: [-0.3, 0.3]}", METHODS=law)
    path.write_text(path.read_text().replace("constant, value: 0", "constant, value: 1"))
    experiment = load_config(path).experiment
    draws = experiment.scenario.draw(experiment.plant, range(1), N)
    draws = draws._replace(w=0.0 * draws.w, v=0.0 * draws.v)
    record, _ = simulate(experiment.plant, experiment.methods[0], draws, np.ones((N + 20, 1)), N)
    assert np.abs(record.u_command).max() > 1.0 and np.abs(record.u).max(axis=1).tolist() == [[0.4, 0.3]]
    np.testing.assert_allclose(record.x_hat, record.x, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("known", "expected"), [("true", (0.005672969, 0.038463108, 0.003402079)),
                                                 ("false", (0.005819799, 0.037672199, 0.003445577))])  # fmt: skip
def test_misses_of_ten_per_cent(tmp_path, known, expected):
    """Oracle: second moments of the loop with random misses, from a linear equation; 5 standard errors."""
    matrices = "kind: linear, A: [[1, 0.1], [0, 0.98]], B: [[0.005], [0.1]], C: [[1, 0]]"
    path = write(tmp_path, f"{{missing: {{probability: 10%, known: {known}}}}}")
    lines = path.read_text().replace("runs: 6", "runs: 100").replace("steps: 40", "steps: 800").splitlines()
    lines[6:8] = [f"plant: {{{matrices}}}", f"model: {{{matrices}, P_w: [1e-5, 1e-3], P_v: 4e-3}}"]
    lines = [line for line in lines if not line.startswith("metrics")]
    path.write_text("\n".join([*lines, "metrics: [mse]"]))
    experiment = load_config(path).experiment
    traces = simulate_block(experiment, experiment.methods[0], range(100)).traces
    x, u, e = (each[:, 200:800] for each in (traces["x"], traces["u"], traces["x_hat"] - traces["x"]))
    for samples, value in zip((x[..., 0] ** 2, u[..., 0] ** 2, e**2), expected, strict=True):
        assert within_stat(samples.reshape(100, -1).mean(axis=1), value)


def test_the_compiled_loop_leaves_the_channel_to_the_other_one(tmp_path):
    """Oracle: the capabilities; a design model with a delay needs the other loop, too."""
    path = write(tmp_path, "none")
    text = path.read_text().replace("runs: 6", "runs: 100000")
    lines = text.splitlines()
    matrices = "kind: linear, A: [[1, 0.1], [0, 0.98]], B: [[0.005], [0.1]], C: [[1, 0]]"
    lines[6:8] = [f"plant: {{{matrices}}}", f"model: {{{matrices}, P_w: [1e-5, 1e-3], P_v: 4e-3@D}}"]
    text = "\n".join(lines).replace("of: f", "of: u.0").replace("runs: all", "runs: 1")
    for law, delay, expected in (
        ("none", "", True),
        ("{delayed: 0}", "", False),
        ("none", ", delay: {input: 1}", False),
    ):
        path.write_text(text.replace("input: none", f"input: {law}").replace("@D", delay))
        experiment = load_config(path).experiment
        assert [applies(experiment, method) for method in experiment.methods] == [expected]


@pytest.mark.parametrize(
    ("law", "model", "path", "message"),
    [
        ("same", "", "noise.input", "the design model has no noise of the input"),
        ("{delayed: 1.5}", "", "noise.input.delayed.samples", "for parts of a sample choose a smaller time.step"),
        ("{delayed: [0, 2]}", "", "model", "the delay of the input is random: say which number the design model"),
        ("{delayed: [0, 2]}", ", delay: same", "model.delay", "model assumes, delay: {input: 1}"),
        ("{delayed: {samples: 1, only: [g]}}", "", "model", "the delay of the input is not that of all inputs: say"),
        ("{missing: {probability: 5%, only: [q]}}", "", "noise.input.missing.only.0", "'q' is not a known"),
        ("{gaussian: {std: [1, 2, 3]}}", "", "noise.input.gaussian.std", ""),
        ("{gaussian: {density: 1}}", "", "noise.input.gaussian.density", "an input is held between two samples"),
    ],
)
def test_mistakes(tmp_path, law, model, path, message):
    with pytest.raises(ConfigError) as error:
        load(tmp_path, law, MODEL=model)
    [problem] = error.value.problems
    assert problem.path.startswith(path) and problem.line > 1 and message in problem.message


@pytest.mark.parametrize(
    "law",
    [
        "kind: minimax-lq, horizon: 3, Q_x: 1, R_u: 1",
        "kind: tube-mpc, horizon: 5, Q_x: 1, R_u: 1, limits: {u: [-9, 9]}, tightening: none",
        "tuning: {kind: lp-noise, Ne2: 14, bounds: [0.5, 4]}, kind: gpc, Np: 5, Q_yw: 1, Q_u: 1",
    ],
)
def test_laws_without_delay_refuse_it(tmp_path, law):
    """At the kind of the controller; `none` lets them act late."""
    kind = law.split("kind: ")[1].split(",")[0]
    key = "tuning.kind" if "tuning" in law else "kind"
    with pytest.raises(ConfigError) as error:
        load(tmp_path, "{delayed: 1}", METHODS=f"{{M: {{controller: {{{law}}}}}}}")
    assert [(each.path, each.message) for each in error.value.problems if "delay" in each.message] == [
        (f"methods.M.controller.{key}", f"{kind} needs a model without delay")
    ]


def test_moments_refuse_laws_of_the_input(tmp_path):
    """As they refuse every law of an input."""
    path = write(tmp_path, "{gaussian: {std: 1}}")
    text = path.read_text().replace("controller: {kind: control-lqr, Q_x: [1, 0.1], R_u: 0.1}", "evaluate: [moments]")
    lines = text.splitlines()
    matrices = "kind: linear, A: [[1, 0.1], [0, 0.98]], B: [[0.005], [0.1]], C: [[1, 0]]"
    lines[6:8] = [f"plant: {{{matrices}}}", f"model: {{{matrices}, P_w: [1e-5, 1e-3], P_v: 4e-3}}"]
    lines = [line for line in lines if not line.startswith(("metrics", "record"))]
    path.write_text("\n".join([*lines, "metrics: [estimation_mse]"]))
    result = cli("check", path)
    assert result.exit_code == 2 and "a law acts on the input" in result.stderr


def test_an_episode_is_the_run(tmp_path):
    """With the commands of the loop; oracle: its inputs that act, its estimates and states, bit for bit."""
    experiment = load(tmp_path, RANDOM, MODEL=", delay: {input: 1}", PLANT=", bounds: {f: [-0.01, 0.01]}")
    method, run = experiment.methods[0], 2
    traces = simulate_block(experiment, method, range(6)).traces
    episode = Episode(experiment, run, method)
    acting = []
    samples = [episode.sample]
    for u in traces["u_command"][run]:
        samples.append(episode.step(u))
        acting.append(episode.u)
    np.testing.assert_array_equal(acting, traces["u"][run])
    for signal in ("x", "x_hat"):
        np.testing.assert_array_equal([getattr(each, signal) for each in samples], traces[signal][run])
