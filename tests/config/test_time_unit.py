"""The key `time.unit`: it stands wherever a unit contains the time, and changes no number."""

import re

import pytest
from small_experiment import cli

from rmpc_bench import load_config, load_trials, run, run_one
from rmpc_bench.types import ConfigError

TEXT = """
version: 1
name: reactor
runs: 4
time: {step: 0.05, duration: 2UNIT}
plant:
  ode: reactor.py:rhs
  states: {CA: mol/l, T: K}
  inputs: {Tc: K}
  bounds: {T: [250, 370], Tc: [280, 320]}
model: {linearise: plant, at: {x: [0.5, 350], u: 300}, noise: {process: [1e-6, 0.01], measurement: [1e-4, 0.25]}}
noise: same
initial: {x: [0.5, 350], x_hat: [0.5, 350], P: [1e-4, 4]}
reference: {kind: constant, value: [0.5, 352]}
controller: {kind: mpc, Hp: 20, Hu: 5, Q: [0, 1], R: 0.1, limits: {u: [280, 320]}}
methods: {KF: {estimator: {kind: kalman}}, MHE: {estimator: {kind: moving-horizon, window: 3}}}
metrics:
  - settling_time
  - {kind: iae, only: [T]}
  - {kind: violation, of: T, limit: [300, 350], what: integral}
  - mse
record: {runs: 2, signals: [y, u, x, x_hat]}
figures:
  - {kind: signals, signals: [y, u], from: 0, to: 1}
  - {kind: scatter, x: x.0, y: x.1, marks: 0.5}
  - boxplot
"""
RHS = """
import numpy as np


def rhs(x, u, p):
    rate = 7.2e10 * np.exp(-8750.0 / x[1]) * x[0]
    return [1.0 - x[0] - rate, 350.0 - x[1] + 209.2 * rate + 2.092 * (u[0] - x[1])]
"""


def written(folder, unit="", **changes):
    """File of the experiment."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "reactor.py").write_text(RHS, encoding="utf-8")
    path = folder / "reactor.yaml"
    text = TEXT.replace("UNIT", unit)
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.long
def test_no_number_changes_and_no_second_is_left(tmp_path):
    """Oracle: the same file without the key, bit for bit; all texts of results and of `check`."""
    texts = {}
    for name, unit in (("s", ""), ("min", ", unit: min")):
        config = load_config(written(tmp_path / name, unit))
        run(config, directory=tmp_path / name / "out", jobs=1, progress=False)
        out = tmp_path / name / "out"
        assert cli("report", out, "--trials").exit_code == 0
        shown = cli("check", tmp_path / name / "reactor.yaml", "--full").stdout
        files = [path for path in out.rglob("*") if path.suffix in (".md", ".tex", ".svg", ".html", ".csv")]
        texts[name] = {str(path.relative_to(out)): path.read_text(encoding="utf-8") for path in files} | {"": shown}
    keys = [load_config(tmp_path / name / "reactor.yaml").points[0].method_keys for name in ("s", "min")]
    assert keys[0] == keys[1]
    csv = {name: each["trials.csv"] for name, each in texts.items()}
    assert csv["min"] == csv["s"] and csv["s"].count("\n") == 9
    units = [info.unit for info in load_trials(tmp_path / "min" / "out").metrics]
    assert units[:3] == ["min", "K*min", "K min"]
    for place, text in texts["min"].items():
        assert " s]" not in text and "[s]" not in text and "1/s" not in text, place
    assert "[s]" in "".join(texts["s"].values()) and "1/s" in texts["s"][""]
    assert "1/min" in texts["min"][""] and "[min]" in "".join(texts["min"].values())
    assert any("t = 0 to 1 min" in text.replace("$", "") for text in texts["min"].values())
    at = r"at most \d+ at t = [\d.]+ min"
    assert re.search(at, " ".join(texts["min"][""].split()))
    assert load_config(tmp_path / "min" / "out" / "config.resolved.yaml").resolved["time"]["unit"] == "min"
    assert "unit" not in load_config(tmp_path / "s" / "reactor.yaml").resolved["time"]


def test_failures_name_the_unit(tmp_path):
    """A run that leaves its bounds says when."""
    path = written(tmp_path, ", unit: h", bound=("T: [250, 370]", "T: [250, 350.2]"))
    one = run_one(load_config(path), "KF")
    assert re.fullmatch(r"T left its bounds \[250, 350.2\] K at [\d.]+ h", one.failure.message)
    result = cli("run", path, "-o", tmp_path / "out", "--jobs", "1")
    files = [each.read_text(encoding="utf-8") for each in (tmp_path / "out").rglob("failures/*.txt")]
    for text in (*files, cli("show", tmp_path / "out", "--run", "0", "--method", "KF").stdout):
        assert re.search(r"t = [\d.]+ h", text) and not re.search(r"t = [\d.]+ s", text), text
    assert files and result.exit_code == 3


@pytest.mark.parametrize("kind", ["plant", "model"])
def test_parameters_in_seconds(kind, tmp_path):
    """Plants and models with such parameters refuse another unit; others than texts are refused."""
    servo = "{kind: servo-linear, noise: {process: 1, measurement: 1}}"
    text = (
        "version: 1\nname: servo\nruns: 1\ntime: {step: 0.1, steps: 5, unit: min}\nmethods: {KF: {estimator: kalman}}\n"
    )
    if kind == "plant":
        text += f"plant: {{kind: servo}}\nmodel: {servo}\n"
    else:
        linear = "A: [[1]], B: [[1]], C: [[1]]"
        text += f"plant: {{kind: linear, {linear}}}\nmodel: {servo}\n"
    path = tmp_path / "servo.yaml"
    path.write_text(text, encoding="utf-8")
    name = "servo" if kind == "plant" else "servo-linear"
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    where = f"4:{text.splitlines()[3].index('min') + 1}: time.unit"
    message = f"the parameters of the {kind} `{name}` are in seconds: time.unit must be s"
    assert f"{where}: {message}" in str(caught.value)


@pytest.mark.parametrize("unit", ["' '", "''", "3", "minutes-and-more", "'a]'", "[min]"])
def test_what_is_no_unit(unit, tmp_path):
    """Up to 12 characters, without those that tables and figures would read as something else."""
    with pytest.raises(ConfigError, match=r"time.unit: must "):
        load_config(written(tmp_path, f", unit: {unit}"))
