"""The key `disturbance` of a design model in configurations: where mistakes are reported, identity, methods, report."""

import numpy as np
import pytest
from small_experiment import cli

from rmpc_bench import load_config
from rmpc_bench.types import ConfigError

TEXT = """
version: 1
name: small
seed: 5
runs: 3
time: {steps: 20}
plant: {kind: servo-linear}
model: {kind: servo-linear, noise: {process: 1, measurement: 1}MODEL}
noise: {measurement: {gaussian: {cov: 1e-4}}}
initial: {x: 0, x_hat: 0, P: PSTART}
reference: {kind: constant, value: pi/2}
estimator: {kind: kalman}
controller: {kind: mpc, Hp: 6, Hu: 2, Q: 0.1, R: 0.1, scale: {u: 440, y: 2*pi}, limits: {u: [-220, 220]}}
methods: METHODS
metrics: [mse, estimation_mse, nees]
record: {runs: 2, signals: [y, u, x, x_hat, P, d_hat]}
figures: [{kind: signals, signals: [y, d_hat, error]}]
"""
BOTH = "{S: {}, D: {model: {disturbance: {at: input, drift: 1e5}}}}"


def write(directory, methods=BOTH, model="", start="process", record=True):
    text = TEXT.replace("METHODS", methods).replace("MODEL", model).replace("PSTART", start)
    if not record:
        text = (
            text.replace(", d_hat]}", "]}").replace("[y, d_hat]", "[y]").replace("signals: [y, d_hat]", "signals: [y]")
        )
        text = text.replace(", d_hat", "")
    path = directory / "small.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("keys", "where", "message"),
    [
        ("{at: output, drift: 10}", "at", "rank of [A - I, B_d; C, C_d] is 4, and nx + nd = 5 is necessary"),
        ("{at: [input, output], drift: 10}", "at", "is 5, and nx + nd = 6 is necessary: 2 disturbances, but 1 output"),
        ("{at: laod, drift: 10}", "at", "did you mean 'load'"),
        ("{at: input, drift: -1}", "drift", "must be >= 0 (got -1)"),
        ("{at: input}", "", "'drift' is missing"),
        ("{at: input, drift: 1, dirft: 2}", "dirft", "is not a known key; did you mean 'drift'?"),
        ("{at: {B_d: [[], [], [], []]}, drift: 1}", "at.B_d", "has no column"),
        ("5", "", "must be a mapping (got 5)"),
    ],
)
def test_mistakes_are_reported_at_their_key(tmp_path, keys, where, message):
    """For the model of one method and for that of all."""
    for path, methods, model in (
        ("methods.D.model", f"{{S: {{}}, D: {{model: {{disturbance: {keys}}}}}}}", ""),
        ("model", "{S: {}}", f", disturbance: {keys}"),
    ):
        with pytest.raises(ConfigError) as error:
            load_config(write(tmp_path, methods, model))
        found = [problem for problem in error.value.problems if message in problem.message]
        assert [problem.path for problem in found] == [f"{path}.disturbance{'.' if where else ''}{where}"]
        assert found[0].line > 0


def test_a_misspelt_key_gets_the_nearest(tmp_path):
    with pytest.raises(ConfigError, match=r"'disturbence' is not a known key; did you mean 'disturbance'\?"):
        load_config(write(tmp_path, "{S: {}}", ", disturbence: {at: input, drift: 1}"))


def test_check_refuses_with_exit_code_2(tmp_path):
    path = write(tmp_path, "{D: {model: {disturbance: {at: output, drift: 10}}}}")
    result = cli("check", path)
    assert result.exit_code == 2 and "Traceback" not in result.stderr
    assert "methods.D.model.disturbance.at: is not detectable" in result.stderr


def test_the_identity_of_methods_without_disturbances_does_not_change(tmp_path):
    """Neither a method nor what all share depends on the disturbances of another method, nor on `none`."""
    alone = load_config(write(tmp_path, "{S: {}}", record=False)).points[0]
    beside = load_config(write(tmp_path)).points[0]
    default = load_config(
        write(tmp_path, "{S: {model: {disturbance: none}}, D: {}}", ", disturbance: {at: input, drift: 1e5}")
    ).points[0]
    for point in (beside, default):
        assert point.method_keys["S"] == alone.method_keys["S"]
        assert point.method_keys["D"] == beside.method_keys["D"] != point.method_keys["S"]
    assert "disturbance" not in str(alone.shared) + str(alone.methods)


def test_the_resolved_configuration_loads_as_the_same(tmp_path):
    config = load_config(write(tmp_path))
    disturbance = config.resolved["methods"]["D"]["model"]["disturbance"]
    assert disturbance == {"at": "input", "drift": 1e5} and "disturbance" not in config.resolved["model"]


def test_where_the_estimator_starts(tmp_path):
    """P of x is extended by D0, which is the drift unless given; d starts at 0."""
    for start, P in (("process", None), ("2", 2.0 * np.eye(4))):
        for extra, D0 in (("", 1e5), (", D0: 7", 7.0)):
            text = f"{{D: {{model: {{disturbance: {{at: input, drift: 1e5{extra}}}}}}}}}"
            estimator = load_config(write(tmp_path, text, start=start)).experiment.methods[0].estimator
            found = estimator.extra["P_pred"][0]
            assert found[4, 4] == pytest.approx(D0, rel=1e-15) and not found[4, :4].any() and not estimator.x0.any()
            if P is not None:
                np.testing.assert_allclose(found[:4, :4], P, rtol=1e-15)


@pytest.mark.long
def test_run_record_and_figures(tmp_path):
    """One worker or two: the same bytes; d_hat is recorded of the method that has it."""
    path = write(tmp_path)
    for name, how in (("one", ("-j", 1)), ("two", ("-j", 2, "--engine", "joblib"))):
        result = cli("run", path, "-o", tmp_path / name, *how)
        assert result.exit_code == 0, result.stderr
    assert (tmp_path / "one" / "trials.csv").read_bytes() == (tmp_path / "two" / "trials.csv").read_bytes()
    with np.load(tmp_path / "one" / "traces.npz") as traces:
        shapes = {name: traces[name].shape for name in traces.files}
    assert any("d_hat" in name for name in shapes) and not any("d_hat" in name and "S" in name for name in shapes)
    result = cli("check", path, "--deep")
    assert result.exit_code == 0 and result.stderr == ""
    shown = " ".join(cli("check", path, "--full").stdout.split())
    assert "at input, drift 100000, detectable: rank 5 of 5" in shown


def test_describe_names_the_key():
    result = cli("describe", "models/servo-linear")
    assert result.exit_code == 0 and "disturbance : unknown disturbances" in result.stdout
