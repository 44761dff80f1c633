"""Components of an installed package: the wheel of tests/example_package, with two broken entry points."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).with_name("example_package")
CONFIG = """
version: 1
name: installed
runs: 4
time: {step: 0.1, steps: 30}
uncertainty: {eps: +-20%}
plant: {kind: double-integrator, mass: 2, perturb: {mass: 1 + eps}}
model: {kind: linear, A: [[1, 0.1], [0, 1]], B: [[0.0025], [0.05]], C: [[1, 0]], P_w: 1e-4, P_v: 1e-2}
noise: {process: {gaussian: {std: 0.01}}, measurement: {gaussian: {std: 0.1}}}
reference: {kind: constant, value: 1}
controller: {kind: saturated-gain, K_p: 2}
methods:
  KF: {estimator: {kind: kalman}}
  EXP: {estimator: {kind: exponential, share: 30%}}
  NAMED: {estimator: {kind: "example-parts:exponential", share: 60%}}
metrics: [mse, overshoot]
figures: [last-values]
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Directory of the installed wheel, and a working directory with a configuration."""
    place, work = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("work")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    # A copy, because a build leaves files beside the sources.
    source = tmp_path_factory.mktemp("source") / "example_package"
    subprocess.run(["cp", "-r", str(PACKAGE), str(source)], check=True)
    subprocess.run([*command, "--target", str(place), str(source)], check=True)
    (work / "installed.yaml").write_text(CONFIG, encoding="utf-8")
    return place, work


@pytest.fixture(scope="module")
def call(installed):
    """Call the command line where the package is installed."""
    place, work = installed
    path = os.pathsep.join([str(place), *filter(None, [os.environ.get("PYTHONPATH")])])

    def cli(*arguments, code=0):
        command = [sys.executable, "-m", "rmpc_bench", *arguments]
        done = subprocess.run(command, cwd=work, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True)
        assert done.returncode == code, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        assert "bug" not in done.stderr
        return done

    return cli


def test_list_shows_package_and_version_and_what_is_broken(call):
    done = call("list", "estimators")
    assert max(map(len, done.stdout.splitlines())) <= 80
    entries = re.split(r"\n (?=\S)", done.stdout)
    lines = {entry.split()[0]: " ".join(entry.split()) for entry in entries}
    assert lines["exponential"].split(maxsplit=1)[1] == "example-parts 1.2.3"
    assert "cannot be loaded" in lines["broken"]
    assert "no_such_library_of_anybody" in lines["broken"]
    assert "NoSuchName" in lines["missing"]
    assert lines["kalman"] == "kalman linear gaps Kalman filter of the nominal model"
    assert "the estimator 'kalman' of example-parts 1.2.3 is not used" in done.stderr


def test_describe_shows_keys_with_their_meaning(call):
    text = call("describe", "exponential").stdout
    assert "share  (default 0.5)" in text
    assert "share of the innovation that corrects the output" in text


def test_describe_of_a_broken_one_says_why(call):
    assert "no_such_library_of_anybody" in call("describe", "estimators/broken", code=2).stderr


def test_schema_has_the_keys(call):
    definitions = json.loads(call("schema").stdout)["definitions"]
    assert definitions["estimators.exponential"]["properties"]["share"]["exclusiveMinimum"] == 0
    assert "estimators.broken" not in definitions


def test_run_and_report(call, installed):
    """The same bytes again from the stored trials; the figure of the package is drawn by `run`."""
    work = installed[1]
    call("run", "installed.yaml", "-o", "results", "--progress", "none")
    assert (work / "results" / "figures" / "last-values.svg").exists()
    before = (work / "results" / "summary.csv").read_bytes()
    text = before.decode()
    assert all(name in text for name in ("KF", "EXP", "NAMED", "overshoot"))
    call("report", "results")
    assert (work / "results" / "summary.csv").read_bytes() == before


@pytest.mark.parametrize(("kind", "reason"), [("broken", "no_such_library_of_anybody"), ("missing", "NoSuchName")])
def test_a_broken_one_is_an_error_of_the_configuration_that_names_it(call, installed, kind, reason):
    text = CONFIG.replace("kind: exponential", f"kind: {kind}")
    (installed[1] / f"{kind}.yaml").write_text(text, encoding="utf-8")
    done = call("check", f"{kind}.yaml", code=2)
    assert f"{kind}.yaml:14:27: methods.EXP.estimator.kind: " in done.stderr
    assert reason in done.stderr


def test_a_key_is_validated_as_that_of_a_built_in_one(call, installed):
    text = CONFIG.replace("share: 30%", "shar: 30%").replace("share: 60%", "share: -1")
    (installed[1] / "keys.yaml").write_text(text, encoding="utf-8")
    lines = call("check", "keys.yaml", code=2).stderr.splitlines()
    assert any("methods.EXP.estimator.shar: 'shar' is not a known key; did you mean 'share'?" in line for line in lines)
    assert any("methods.NAMED.estimator.share: must be > 0 (got -1)" in line for line in lines)


@pytest.mark.parametrize(
    "name", ["exponential", "saturated-gain", "double-integrator", "overshoot", "last-values", "broken"]
)
def test_the_checks_of_built_in_components_are_those_of_the_package(call, name):
    done = call("check", "--component", name, code=1 if name == "broken" else 0)
    assert ("No module named" if name == "broken" else " passed") in " ".join(done.stdout.split())


def test_two_packages_with_one_name_are_told_apart(call, installed, tmp_path):
    """A second package with the same entry point, made by hand: its metadata is all that counts."""
    place, work = installed
    second = place / "second_parts-0.1.dist-info"
    second.mkdir()
    (second / "METADATA").write_text("Metadata-Version: 2.1\nName: second-parts\nVersion: 0.1\n", encoding="utf-8")
    points = "[rmpc_bench.estimators]\nexponential = example_parts.filters:Exponential\n"
    (second / "entry_points.txt").write_text(points, encoding="utf-8")
    try:
        done = call("check", "installed.yaml", code=2)
        assert "methods.EXP.estimator.kind: 'exponential' is in example-parts and second-parts; " in done.stderr
        assert "write example-parts:exponential or second-parts:exponential" in done.stderr
        assert "methods.NAMED" not in done.stderr
        names = re.findall(r"^ (\S+)", call("list", "estimators").stdout, re.MULTILINE)
        assert {"example-parts:exponential", "second-parts:exponential"} <= {*names}
    finally:
        for path in second.iterdir():
            path.unlink()
        second.rmdir()
