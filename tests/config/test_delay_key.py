"""The key `delay` of a design model in configurations: what methods get, defaults, identity and mistakes."""

import pytest

from rmpc_bench import load_config
from rmpc_bench.types import ConfigError, KnownDelay

TEXT = """
version: 1
name: late
runs: 2
time: {steps: 5}
plant: {kind: linear, A: [[1, 0.1], [0, 0.98]], B: [[0.005], [0.1]], C: [[1, 0], [0, 1]]}
model: {kind: linear, A: [[1, 0.1], [0, 0.98]], B: [[0.005], [0.1]], C: [[1, 0], [0, 1]], P_w: 1e-3, P_v: 1DELAY}
noise: none
reference: {kind: constant, value: 0}
estimator: {kind: kalman}
controller: {kind: lqr, horizon: 5, Q_x: 1, R_u: 1}
methods: METHODS
metrics: [mse]
"""


def load(directory, delay="", methods="{M: {}}", text=TEXT):
    """Load the configuration with this value of `delay` for the common model."""
    path = directory / "late.yaml"
    path.write_text(text.replace("DELAY", delay and f", delay: {delay}").replace("METHODS", methods))
    return load_config(path)


@pytest.mark.parametrize(
    ("delay", "expected"),
    [
        ("", (0, (0, 0))),
        ("none", (0, (0, 0))),
        ("same", (0, None)),
        ("{input: 2}", (2, (0, 0))),
        ("{input: 1, measurement: 3}", (1, (3, 3))),
        ("{measurement: {y.1: 2}}", (0, (0, 2))),
        ("{input: 1, measurement: same}", (1, None)),
    ],
)
def test_what_the_methods_get(tmp_path, delay, expected):
    """The record of the method, for the common model and for that of one method."""
    [method] = load(tmp_path, delay).experiment.methods
    assert method.delay == KnownDelay(*expected)
    own = load(tmp_path, "same", f"{{M: {{model: {{delay: {delay or 'none'}}}}}}}").experiment.methods[0]
    assert own.delay == KnownDelay(*expected)


@pytest.mark.parametrize(
    ("delay", "path", "message"),
    [
        ("3", "", "say input or measurement: {input: 3} or {measurement: 3}"),
        ("sane", "", "(got 'sane')"),
        ("{inputs: 1}", "inputs", "did you mean 'input'"),
        ("{input: 1.5}", "input", "must be a whole number"),
        ("{input: -1}", "input", "must be >= 0"),
        ("{}", "", "say input or measurement, such as {input: 1}"),
        ("{input: same}", "input", "must be a whole number of samples (got 'same'); `delay: same` stands for all"),
        ("{measurement: none}", "measurement", "must be a whole number of samples (got 'none'); `delay: none`"),
        ("{measurement: {y.0: same}}", 'measurement."y.0"', "must be a whole number of samples (got 'same')"),
        ("{measurement: {}}", "measurement", "has too few entries"),
        ("{measurement: [2, 0]}", "measurement", "expected a number or 'same' or a mapping (got a list of 2)"),
        ("{measurement: 101}", "measurement", "must be <= 100"),
        ("{measurement: {y.2: 1}}", 'measurement."y.2"', "'y.2' is not a known output; did"),
    ],
)
def test_mistakes_are_reported_at_their_key(tmp_path, delay, path, message):
    for where, found in (
        ("model", (delay,)),
        ("methods.M.model", ("", f"{{M: {{model: {{delay: {delay}}}}}}}")),
    ):
        with pytest.raises(ConfigError) as error:
            load(tmp_path, *found)
        [problem] = error.value.problems
        assert (problem.path, problem.line > 1) == (f"{where}.delay{path and '.'}{path}", True)
        assert message in problem.message


def test_a_delay_of_the_plant_is_a_law_of_a_channel(tmp_path):
    """It is refused at the key of the plant, whose meaning the message gives."""
    with pytest.raises(ConfigError) as error:
        load(tmp_path, text=TEXT.replace("plant: {", "plant: {delay: 2, "))
    [problem] = error.value.problems
    assert (problem.path, problem.line, problem.column) == ("plant.delay", 6, 9)
    assert problem.message == "a delay is a law of a channel: noise: {input: {delayed: 2}}"


def test_models_of_the_plant_know_its_delays(tmp_path):
    """`same` by default for `linearise` and `nonlinear`; for `from` where the noise has a delay, at no cost of bits."""
    (tmp_path / "eq.py").write_text("def rhs(x, u, p):\n    return u - x\n")
    plant, noise = "plant: {ode: eq.py:rhs, states: [h], inputs: [q]}\n", "noise: {process: 1, measurement: 1}"
    lines = TEXT.splitlines(keepends=True)
    for kind in ("linearise", "nonlinear"):
        lines[5:7] = [plant, f"model: {{{kind}: plant, at: {{u: 0, guess: 0}}, {noise}DELAY}}\n"]
        assert load(tmp_path, text="".join(lines)).experiment.methods[0].delay == (0, None)
        assert load(tmp_path, "none", text="".join(lines)).experiment.methods[0].delay == (0, (0,))
    servo = (TEXT.splitlines(keepends=True), "model: {from: plant, noise: {process: 1, measurement: 1}DELAY}\n")
    servo[0][5:7] = ["plant: {kind: servo-linear}\n", servo[1]]
    config = load(tmp_path, text="".join(servo[0]))
    assert "delay" not in config.resolved["model"] and config.experiment.methods[0].delay == (0, (0,))


def test_the_identity_of_methods_without_the_key_does_not_change(tmp_path):
    """A delay is a part of the identity of its method, not of what all share, and methods share their designs."""
    alone = load(tmp_path).points[0]
    beside = load(tmp_path, methods="{M: {}, D: {model: {delay: {input: 1}}}}").points[0]
    assert beside.experiment_hash == alone.experiment_hash and "delay" not in str(alone.methods)
    assert beside.method_keys["M"] == alone.method_keys["M"] != beside.method_keys["D"]
    assert load(tmp_path, "{input: 1}").resolved["model"]["delay"] == {"input": 1, "measurement": 0}
