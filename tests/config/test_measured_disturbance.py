"""The key `input` with `only`: a measured disturbance beside a controller of the other inputs."""

import io

import numpy as np
import pandas as pd
import pytest
from conftest import ROUND, SOLVER
from small_experiment import cli, ran
from uncertain_experiment import write_estimation

from rmpc_bench import load_config
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.episode import Episode
from rmpc_bench.types import ConfigError

MATRICES = "A: 0.8, B: [[0.5, 0.3]], C: 1"
MPC = "{kind: mpc, Hp: 1, Hu: 1, Q: 1, R: 0}"
D = "kind: steps, times: [0, 5], values: [0, 0.7]"
SCALAR = {
    "plant": f"{{kind: linear, {MATRICES}}}",
    "model": f"{{kind: linear, {MATRICES}, P_w: 1, P_v: 1e-6}}",
    "initial": "{x: 0, x_hat: 0, P: 0}",
    "time": "{steps: 8}",
    "reference": "{kind: constant, value: 1}",
    "noise": "none",
    "runs": 2,
    "metrics": "[mse]",
}


def written(tmp_path, law=MPC, signal=f"{{{D}, only: [1]}}", estimator="kalman", **changes):
    """A file with a scalar plant of two inputs, the second of which is a disturbance."""
    methods = f"{{M: {{estimator: {{kind: {estimator}}}, controller: {law}}}}}"
    return write_estimation(tmp_path, **(SCALAR | {"methods": methods, "input": signal} | changes))


def recorded(path):
    """Signals of the runs."""
    experiment = load_config(path).experiment
    draws = experiment.scenario.draw(experiment.plant, range(experiment.n_runs), experiment.n_steps)
    r = experiment.scenario.reference.sample(experiment.n_steps + 30)
    return simulate(experiment.plant, experiment.methods[0], draws, r, experiment.n_steps)[0]


def test_mpc_knows_the_disturbance_now(tmp_path):
    """Oracle: the values of the closed form: y = r although d jumps."""
    record = recorded(written(tmp_path))
    np.testing.assert_allclose(record.x[0, 1:, 0], 1.0, **ROUND)
    np.testing.assert_allclose(record.u[0, [0, 1, 5], 0], [2.0, 0.4, -0.02], **ROUND)
    np.testing.assert_array_equal(record.u[0, :, 1], [0, 0, 0, 0, 0, 0.7, 0.7, 0.7])
    np.testing.assert_allclose(record.x_hat, record.x, **ROUND)


def test_neither_knows_it(tmp_path):
    """Oracle: the value of the closed form one sample after the jump; x_hat is not told."""
    record = recorded(written(tmp_path, signal=f"{{{D}, only: [1], known: false}}"))
    np.testing.assert_allclose(record.x[0, 6, 0], 1.21, **ROUND)
    np.testing.assert_allclose(record.u[0, :2, 0], [2.0, 0.4], **ROUND)


def test_an_episode_is_the_run(tmp_path):
    """Oracle: the estimates of the loop, bit for bit, of a method that does not know the disturbance."""
    path = written(tmp_path, signal=f"{{{D}, only: [1], known: false}}")
    experiment, record = load_config(path).experiment, recorded(path)
    episode = Episode(experiment, 0, experiment.methods[0])
    samples = [episode.sample, *(episode.step(u) for u in record.u[0])]
    np.testing.assert_array_equal([each.x_hat for each in samples], record.x_hat[0])


@pytest.mark.parametrize(
    "law",
    [
        "{kind: mpc, Hp: 6, Hu: 2, Q: 1, R: 0.1}",
        "{kind: mpc, Hp: 6, Hu: 2, Q: 1, R: 0.1, limits: {u: [-9, 9], enforce: qp}}",
        "{kind: gpc, Np: 6, Q_yw: 1, Q_u: 0.5}",
        "{kind: lqr, horizon: 6, Q_x: 1, R_u: 0.5}",
        "{kind: lqg, Q_x: 1, R_u: 0.5, Q_i: 0.1}",
    ],
)
def test_it_acts_as_a_known_mean_of_the_process_noise(tmp_path, law):
    """Oracle: the law of the plant with one input, told the mean 0.3 d by a model that has it, at d = 0.7."""
    constant = f"{{{D.replace('[0, 0.7]', '[0.7, 0.7]')}, only: [1]}}"
    reference = {"reference": "{kind: constant, value: 0}"} if "lqr" in law else {}
    record = recorded(written(tmp_path, law, constant, **reference))
    one = "A: 0.8, B: 0.5, C: 1"
    keys = {"plant": f"{{kind: linear, {one}}}", "model": f"{{kind: linear, {one}, P_w: 1, P_v: 1e-6, w_mean: 0.21}}"}
    noise = "{process: {gaussian: {mean: 0.21, std: 0}}}"
    other = recorded(written(tmp_path, law, None, noise=noise, **keys, **reference))
    np.testing.assert_allclose(record.u[0, :, 0], other.u[0, :, 0], **SOLVER)
    np.testing.assert_allclose(record.x[0], other.x[0], **SOLVER)
    assert np.abs(record.u[0, :, 0]).max() > 0.1


def test_feedforward_of_pid(tmp_path):
    """Oracle: u = e - 0.6 d; that of the loop by hand."""
    record = recorded(written(tmp_path, "{kind: pid, Kp: 1, feedforward: {u.1: -0.6}}"))
    x = 0.0
    for k in range(8):
        d = 0.7 * (k >= 5)
        u = 1.0 - x - 0.6 * d
        np.testing.assert_allclose(record.u[0, k], [u, d], **ROUND)
        x = 0.8 * x + 0.5 * u + 0.3 * d
    with pytest.raises(ConfigError, match=r"feedforward: 'u.0' is not a known measured disturbance"):
        load_config(written(tmp_path, "{kind: pid, Kp: 1, feedforward: {u.0: -0.6}}"))


CODE = """
def rhs(x, u, p): return [x[1], u[0] - u[1] - 0.5 * x[1] - x[0] ** 3]
def out(x, p): return [x[0]]
"""


def test_names_bounds_an_operating_point_and_slower_calls(tmp_path):
    """Oracle: at the operating point nothing moves; deviations are those of d from its value there."""
    (tmp_path / "own.py").write_text(CODE, encoding="utf-8")
    plant = (
        "{ode: own.py:rhs, output: own.py:out, states: [a, b], inputs: [load, f], outputs: [h], bounds: {f: [-9, 9]}}"
    )
    plant = plant.replace("[load, f]", "[f, load]")
    point = "at: {x: [1, 0], u: [1.5, 0.5]}, noise: {process: 1e-6, measurement: 1e-6}"
    keys = {
        "plant": plant,
        "model": f"{{linearise: plant, {point}}}",
        "initial": "{x: [1, 0], x_hat: [1, 0], P: 0}",
        "time": "{step: 0.1, steps: 20}",
    }
    law = "{kind: mpc, Hp: 8, Hu: 2, Q: 1, R: 0.01, limits: {u: [-9, 9]}, every: 2}"
    signal = "{kind: steps, times: [0, 1], values: [0.5, %s], only: [load]}"
    rest = recorded(written(tmp_path, law, signal % 0.5, **keys))
    np.testing.assert_allclose(rest.u[0], [[1.5, 0.5]] * 20, atol=1e-8)  # of the integration
    moved = recorded(written(tmp_path, law, signal % 0.9, **keys))
    assert moved.u[0, 9, 0] < 1.5 + 1e-8 < moved.u[0, 10, 0]
    np.testing.assert_array_equal(moved.u[0, ::2, 0], moved.u[0, 1::2, 0])
    blind = recorded(written(tmp_path, law, (signal % 0.9)[:-1] + ", known: false}", **keys))
    assert abs(blind.u[0, 10, 0] - 1.5) < 1e-8


def test_the_written_file_loads_as_the_same(tmp_path):
    """Same hash; another one than without the disturbance, or where it is not known; a run by the command line."""
    path = written(tmp_path)
    config = load_config(path)
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    assert load_config(copy).hash == config.hash
    assert load_config(written(tmp_path, signal=f"{{{D}, only: [1], known: false}}")).hash != config.hash
    table = pd.read_csv(io.BytesIO(ran(written(tmp_path), tmp_path / "out")))
    # Of the first of eight samples alone.
    np.testing.assert_allclose(table["mse"], 1 / 8, **ROUND)
    assert cli("check", path).exit_code == 0


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        ({"signal": f"{{{D}}}"}, "input", "replaces the controller of all methods"),
        ({"signal": f"{{{D}, only: [load]}}"}, "input.only.0", "'load' is not a known input"),
        ({"signal": f"{{{D}, only: [2]}}"}, "input.only.0", "'2' is not a known input"),
        ({"signal": f"{{{D}, only: [0, 1]}}"}, "input.only", "the controller needs one of them"),
        ({"signal": f"{{{D}, only: [1, 1]}}"}, "input.only", "each once"),
        ({"signal": f"{{{D}, only: []}}"}, "input.only", "too few entries"),
        ({"signal": f"{{{D}, only: [1], known: 3}}"}, "input.known", "must be true or false"),
        (
            {"methods": "{M: {estimator: {kind: kalman}}}", "reference": None, "metrics": "[estimation_mse]"},
            "input.only",
            "needs a controller of the other inputs",
        ),
        (
            {"methods": "{M: {estimator: {kind: kalman}}}", "reference": None, "metrics": "[estimation_mse]",
             "signal": f"{{{D}, known: false}}"},
            "input.known",
            "has no effect without `only`",
        ),
        ({"law": "{kind: control-lqr, Q_x: 1, R_u: 1}"}, "methods.M.controller", "use lqr, mpc or gpc"),
        ({"estimator": "nosuch", "law": "{kind: pid, Kp: 1}"}, "methods.M.estimator.kind", "'nosuch'"),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path, changes, path, words):
    """With the place of the key."""
    with pytest.raises(ConfigError) as caught:
        load_config(written(tmp_path, **changes))
    found = {problem.path: problem.message for problem in caught.value.problems}
    assert any(words in message for at, message in found.items() if at.startswith(path)), found
    assert "needs a controller" not in words or len(caught.value.problems) == 1


def test_it_needs_a_file_for_every_run(tmp_path):
    """As an input without `only`."""
    for number in range(2):
        (tmp_path / f"d{number}.csv").write_text("d\n" + "0.1\n" * 8, encoding="utf-8")
    signal = "{kind: file, file: 'd*.csv', columns: d, only: [1]}"
    assert recorded(written(tmp_path, signal=signal)).u[1, 0, 1] == 0.1
    with pytest.raises(ConfigError, match="there are 3 runs, and `input.file` names 2 files"):
        load_config(written(tmp_path, signal=signal, runs=3))


def test_the_plant_may_limit_the_disturbance(tmp_path):
    """`check` remarks on the inputs of the law alone."""
    (tmp_path / "own.py").write_text(CODE, encoding="utf-8")
    keys = {
        "plant": "{ode: own.py:rhs, output: own.py:out, states: [a, b], inputs: [f, d], outputs: [h], "
        "bounds: {f: [-9, 9], d: [-2, 2]}}",
        "model": "{linearise: plant, at: {x: [0, 0], u: 0}, noise: {process: 1e-6, measurement: 1e-6}}",
        "initial": "{x: 0, x_hat: 0, P: 0}",
        "time": "{step: 0.1, steps: 8}",
    }
    for limits, said in ((", limits: {u: [-9, 9]}", ""), ("", "the plant limits `f` to [-9, 9]")):
        law = f"{{kind: mpc, Hp: 4, Hu: 2, Q: 1, R: 0.1{limits}}}"
        text = " ".join(cli("check", written(tmp_path, law, **keys)).stdout.split())
        assert "the plant limits `d`" not in text and ("the plant limits" in text) == bool(said) and said in text
