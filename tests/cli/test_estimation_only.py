"""The command line on experiments without a controller: what it says, what it writes, what it imports."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from small_experiment import cli, ran, spied
from uncertain_experiment import PLANT, write_estimation, write_taking

CONFIGS = Path(__file__).parents[2] / "configs"
BOTH = {"evaluate": "[runs, moments]"}
CLAIMS = "[{says: bounded, source: us, check: 'all(var(e[ERP]) <= diag(P[ERP]) + 1e-12)', finding: confirmed}]"
IMPORTED = """
import sys
from rmpc_bench.cli import main
try:
    main(sys.argv[1:], prog_name="rmpc-bench")
except SystemExit as done:
    assert not done.code, done.code
print(*{name.split(".")[0] for name in sys.modules}, file=sys.stderr)
"""

VARIANCE = "{kind: signals, signals: [variance]}"


@pytest.mark.parametrize("name", ["souto2011/fig4.yaml", "souto2011/guarantee.yaml", "benchmarks/souto2011.yaml"])
@pytest.mark.long
def test_check_stays_light(name):
    """Oracle: the modules of a process; no compiler, pandas or matplotlib, with moments and an adversary."""
    command = [sys.executable, "-c", IMPORTED, "check", str(CONFIGS / name)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert not set(done.stderr.split()) & {"numba", "pandas", "matplotlib", "joblib", "rich"}


DEEP = [
    # The two that take seconds; the others have many systems, long runs or the search of an adversary.
    pytest.param(path, marks=[pytest.mark.slow] * (path.stem not in ("alpha", "table")), id=path.stem)
    for path in sorted(CONFIGS.glob("souto2011/*.yaml"))
]


@pytest.mark.parametrize("path", DEEP)
@pytest.mark.long
def test_deep(path):
    """It looks at every point without a failure, and does not claim that there are laws of control."""
    result = cli("check", "--deep", path)
    assert result.exit_code == 0 and result.stderr == ""
    assert "nan" not in result.stdout.split("divergence of the plant")[1]
    assert "no controller" in result.stdout


def test_moments_alone(tmp_path):
    """Nothing runs, the screen says so, claims are judged, and the same command does it again."""
    path = write_estimation(
        tmp_path, evaluate="moments", claims=CLAIMS, figures="[{kind: signals, signals: [variance]}]"
    )
    for _ in range(2):
        result = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--strict")
        assert result.exit_code == 0, result.output
        assert result.stdout.startswith("estimation   exact moments, no runs")
        assert " confirmed: 1 statement of the paper (claims.md)" in result.stdout
        assert "error at the end" in result.stdout and "exact" in result.stdout
    assert (tmp_path / "out" / "trials.csv").read_text(encoding="utf-8") == "method,run,status,estimation_mse\n"
    assert (tmp_path / "out" / "figures" / "signals.svg").exists()
    (verdict,) = json.loads((tmp_path / "out" / "claims.json").read_text(encoding="utf-8"))["claims"]
    assert verdict["finding"] == "confirmed"


def test_a_dry_run_of_moments(tmp_path):
    """There is nothing to compute."""
    result = cli("run", write_estimation(tmp_path, evaluate="moments"), "-o", tmp_path / "out", "-n")
    assert result.exit_code == 0 and "0 of 0 trials to compute" in result.stdout
    assert not (tmp_path / "out").exists()


def test_report_of_what_is_stored(tmp_path, monkeypatch):
    """From the directory alone, without a simulation: tables, series and figures of runs and moments, by bytes."""
    path = write_estimation(tmp_path, **BOTH, figures="[{kind: signals, signals: [variance]}, boxplot]")
    ran(path, tmp_path / "out")
    names = ("trials.csv", "series.csv", "summary.csv", "tables/summary.md", "figures/signals.svg")
    before = {name: (tmp_path / "out" / name).read_bytes() for name in names}
    path.unlink()
    shutil.rmtree(tmp_path / "out" / "figures")
    blocks = spied(monkeypatch)
    result = cli("report", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert blocks == []
    assert {name: (tmp_path / "out" / name).read_bytes() for name in names} == before


def test_report_of_moments_alone(tmp_path):
    """There is a store without trials; it is no empty directory."""
    ran(write_estimation(tmp_path, evaluate="moments"), tmp_path / "out")
    result = cli("report", tmp_path / "out")
    assert result.exit_code == 0 and "exact moments, no runs" in result.stdout


def test_only_one_method(tmp_path):
    """Its ensemble stands alone until the other one is computed; then it is the whole experiment."""
    path = write_estimation(tmp_path, **BOTH, figures="[{kind: signals, signals: [variance]}]")
    first = ran(path, tmp_path / "whole")
    ran(path, tmp_path / "out", "--only", "ERP")
    assert "KF" not in (tmp_path / "out" / "series.csv").read_text(encoding="utf-8")
    assert ran(path, tmp_path / "out") == first
    assert (tmp_path / "out" / "series.csv").read_bytes() == (tmp_path / "whole" / "series.csv").read_bytes()


def test_a_single_run(tmp_path):
    """It has no covariance over runs, and the exact moments stand alone."""
    path = write_estimation(tmp_path, **BOTH, figures=f"[{VARIANCE}, boxplot]")
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--runs", 1)
    assert result.exit_code == 0, result.output
    assert "exact" in result.stdout


def test_every_run_fails(tmp_path):
    """A plant that runs away: statuses, exit 3, and neither tables nor figures fail."""
    plant = PLANT.replace("[[0.9, 0.2], [0, 0.7]]", "[[1e60, 0], [0, 0.7]]")
    model = "{kind: uncertain-linear, A: 0.5, C: [[1, 0]], W: 1, V: 1}"
    keys = {"plant": plant, "model": model, "methods": "{KF: {estimator: {kind: kalman-predictor}}}"}
    noise = "{process: {gaussian: {std: 1}}}"
    path = write_estimation(tmp_path, **BOTH, **keys, noise=noise, figures=f"[{VARIANCE}, boxplot]")
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1)
    assert result.exit_code == 3 and "Traceback" not in result.output
    assert "6 failed" in result.stdout
    assert cli("report", tmp_path / "out").exit_code == 3


def test_remarks_of_designs(tmp_path):
    """What a design has to say is shown with the name of its method."""
    plain = cli("check", write_estimation(tmp_path, methods="{KF: {estimator: {kind: kalman}}}")).stdout
    assert " -  " not in plain
    shown = cli("check", CONFIGS / "souto2011" / "fig4.yaml").stdout
    assert "\n -  ERP: " in shown


def test_smoke_of_a_plant_from_a_file(tmp_path):
    """A smoke run finds the file, too, and its own resolved form can be read."""
    write_estimation(tmp_path, file="bench.yaml")
    path = write_taking(tmp_path, "{from: bench.yaml}", metrics="[{kind: nees, from: 8}]", smoke="{runs: 2, steps: 5}")
    assert cli("run", path, "-o", tmp_path / "out", "-j", 1, "--smoke").exit_code == 0
    (tmp_path / "bench.yaml").unlink()
    result = cli("report", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "2 of 2 runs" in result.stdout


def test_the_same_noise_as_a_model_without_any(tmp_path):
    """Oracle: W = V = 0 unless given; nobody means that by `same`."""
    shown = cli(
        "check",
        write_estimation(tmp_path, model="{from: plant}", noise="same", methods="{KF: {estimator: {kind: lmmse}}}"),
    ).stdout
    assert "process noise: `same` as that of the design model, which has none" in shown
    assert "measurement noise: `same` as that of the design model, which has none" in shown
    assert "which has none" not in cli("check", write_estimation(tmp_path)).stdout
