"""An own plant, data files, copies of the sources and versions of libraries: what identifies an experiment."""

import json
import shutil

import pytest
from small_experiment import cli

from rmpc_bench import load_config, load_trials
from rmpc_bench.config.own_code import in_directory
from rmpc_bench.config_file.yaml import load
from rmpc_bench.results import other_code
from rmpc_bench.types import ConfigError

TANK = """
def rhs(x, u, p):
    return [p.k * u[0] - 0.3 * x[0]]


def output(x, p):
    return [x[0]]
"""
OBSERVER = """
import filterpy
import numpy as np
from rmpc_bench import single_run
from rmpc_bench.types import DataFiles


@single_run
class Observer:
    deterministic = True

    def __init__(self, model, table: DataFiles):
        self.model, self.gain = model, float(np.loadtxt(table[0]))

    def start(self, x0, P0):
        self.x = x0

    def update(self, y, u_previous):
        if u_previous is not None:
            self.x = self.model.A @ self.x + self.model.B @ u_previous
        self.x = self.x + self.gain * (y - self.model.C @ self.x)
        return self.x
"""
CONFIG = """
version: 1
name: tank
seed: 7
runs: 2
time: {step: 0.1, steps: 5}
plant: {ode: plants/tank.py:rhs, output: plants/tank.py:output, states: [h], outputs: [level], inputs: [q],
  parameters: {k: 1.0}, solver: {method: rk4, substeps: 2}}
model: {kind: linear, A: 0.97, B: 0.1, C: 1, P_w: 0.01, P_v: 0.01}
noise: {measurement: {gaussian: {std: 0.05}}}
initial: {x: 1, x_hat: 1, P: process}
reference: {kind: constant, value: 0}
controller: {kind: lqr, Q_x: 1, R_u: 1, horizon: 20}
methods:
  KF: {estimator: {kind: kalman}}
  One: {estimator: {file: observer.py:Observer, table: data/gain.csv}}
  Two: {estimator: {file: observer.py:Observer, table: 'data/g*.csv'}}
metrics: [mse]
figures: []
"""
FILES = {"plants/tank.py": TANK, "observer.py": OBSERVER, "data/gain.csv": "0.5", "tank.yaml": CONFIG}


def written(directory):
    """Write the files into a directory and return the configuration."""
    for name, text in FILES.items():
        path = directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return directory / "tank.yaml"


def edit(file, before, after):
    """Replace a text in a file."""
    assert before in file.read_text()
    file.write_text(file.read_text().replace(before, after))


def run(path, out, *options):
    """Call `rmpc-bench run` with one worker."""
    return cli("run", path, "-o", out, "-j", 1, "--progress", "none", *options)


@pytest.fixture(scope="module", autouse=True)
def no_first_calls():
    """Leave out the calls before any run, which nothing here is about."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rmpc_bench.config.own_code.FirstCalls.estimates", lambda *_: {})
        yield


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Return a configuration and the directory of its results."""
    home = tmp_path_factory.mktemp("own")
    path = written(home)
    result = run(path, home / "out")
    assert result.exit_code == 0, result.output
    # What a named data file holds is hashed, so that no warning is needed.
    assert "loadtxt" not in result.stderr
    return path, home / "out"


@pytest.fixture
def copied(stored, tmp_path):
    """Return a copy of both, to be changed."""
    shutil.copytree(stored[0].parent, tmp_path / "copy")
    return tmp_path / "copy" / "tank.yaml", tmp_path / "copy" / "out"


def test_equal_methods_share_trials_and_the_path_does_not_count(stored, tmp_path):
    """Two methods whose data files have the same content, however they are named; the same files elsewhere."""
    here = load_config(stored[0]).points[0]
    assert here.method_keys["One"] == here.method_keys["Two"] != here.method_keys["KF"]
    there = load_config(written(tmp_path / "a b")).points[0]
    assert (there.experiment_hash, there.method_keys) == (here.experiment_hash, here.method_keys)
    assert str(tmp_path) not in json.dumps([there.shared, there.methods, there.own_code])


@pytest.mark.long
def test_a_data_file_counts(copied):
    """Its methods are computed again; the screen names the file."""
    path, out = copied
    (path.parent / "data" / "gain.csv").write_text("0.9")
    result = run(path, out)
    said = "gain.csv has changed since 2 runs were stored: computing them again (old ones kept)"
    assert f"One, Two: {said}" in result.stderr and "KF:" not in result.stderr
    assert run(path, out, "-n").stdout.startswith("tank: 0 of 4 trials")


def test_a_changed_plant_is_another_experiment(copied):
    """Exit code 5, with the name of the file, its earlier copy and the way out; a comment changes nothing."""
    path, out = copied
    tank = path.parent / "plants" / "tank.py"
    edit(tank, "def rhs(x, u, p):", "def rhs(x, u, p):  # rates")
    assert run(path, out, "-n").stdout.startswith("tank: 0 of 4 trials")
    edit(tank, "0.3", "0.4")
    result = run(path, out)
    assert result.exit_code == 5
    assert "plant: plants/tank.py has changed since the trials were stored (earlier files: code/" in result.stderr
    assert f"for a new directory: rmpc-bench run {path} -o {out}-2" in result.stderr
    folder = result.stderr.partition("earlier files: ")[2].partition(")")[0]
    assert "0.3 * x[0]" in (out / folder / "tank.py").read_text()


def test_the_resolved_configuration_loads_from_the_copies(copied, monkeypatch, tmp_path):
    """From any place, with the same keys, after the sources are gone; data files are named relative to it."""
    path, out = copied
    before = load_config(path)
    for name in ("observer.py", "plants/tank.py", "tank.yaml"):
        (path.parent / name).unlink()
    monkeypatch.chdir(tmp_path)
    moved = path.parent.rename(tmp_path / "moved") / "out"
    after = load_config(moved / "config.resolved.yaml")
    assert after.hash == before.hash and after.points[0].method_keys == before.points[0].method_keys
    named = load(moved / "config.resolved.yaml")
    assert named["methods"]["One"]["estimator"]["file"].startswith("code/")
    assert named["methods"]["Two"]["estimator"]["table"] == "../data/g*.csv"
    assert run(moved / "config.resolved.yaml", moved, "-n").stdout.startswith("tank: 0 of 4 trials")
    assert len(load_trials(moved).runs) == 2


def test_data_files_are_found_from_results_behind_a_link(stored, tmp_path):
    """Trap: the system goes up with `..` from what the link points to, not from the link."""
    (tmp_path / "disk" / "deep").mkdir(parents=True)
    link = tmp_path / "results"
    link.symlink_to(tmp_path / "disk" / "deep")
    config = load_config(stored[0])
    table = in_directory(config.resolved, link, config.own)["methods"]["One"]["estimator"]["table"]
    assert (link / table).read_text() == FILES["data/gain.csv"]


def test_a_neighbour_outside_the_directory_needs_consent(tmp_path):
    """A symbolic link beside the file leads out of the directory."""
    path = written(tmp_path / "here")
    (tmp_path / "gains.py").write_text("K = 1")
    (tmp_path / "here" / "gains.py").symlink_to(tmp_path / "gains.py")
    edit(tmp_path / "here" / "observer.py", "import filterpy", "import gains")
    with pytest.raises(ConfigError, match=r"gains.py, which observer.py imports, is outside .* --allow-code"):
        load_config(path)
    assert load_config(path, allow_code=[tmp_path / "gains.py"])


@pytest.mark.long
def test_another_version_of_a_library(copied, monkeypatch):
    """A patch is said; major or minor is refused with both versions and the way out, until it is accepted."""
    path, out = copied
    here = other_code.distribution_of("filterpy")[1]
    assert json.loads((out / "manifest.json").read_text())["libraries"]["filterpy"] == here

    def pretend(version):
        known = other_code.distribution_of
        found = lambda module: ("filterpy", version) if module == "filterpy" else known(module)  # noqa: E731
        monkeypatch.setattr(other_code, "distribution_of", found)

    pretend(f"{here}1")
    result = run(path, out)
    assert result.exit_code == 0 and f"some trials were computed with filterpy {here}" in result.stderr
    pretend("99.1.0")
    result = run(path, out)
    assert result.exit_code == 5 and "--accept-versions uses these rows" in result.stderr
    assert f"One, Two: 2 stored runs were computed with filterpy {here}; here filterpy 99.1.0" in result.stderr
    assert "KF:" not in result.stderr
    assert run(path, out, "--accept-versions").exit_code == 0
    assert run(path, out).exit_code == 0


def test_a_component_that_is_not_deterministic_shares_no_trials(tmp_path):
    """Its method's name is a part of the key."""
    path = written(tmp_path)
    edit(tmp_path / "observer.py", "deterministic = True", "deterministic = False")
    keys = load_config(path).points[0].method_keys
    assert keys["One"] != keys["Two"]


@pytest.mark.long
def test_files_of_a_sweep(tmp_path):
    """Every point has the code of its file, also in the resolved configuration; full hashes differ."""
    path = written(tmp_path)
    (tmp_path / "slow.py").write_text(OBSERVER.replace("self.gain *", "0.5 * self.gain *"))
    (tmp_path / "same.py").write_text(OBSERVER.replace("import numpy", "# numbers\nimport numpy"))
    edit(path, "metrics:", "sweep: {grid: {methods.One.estimator.file: [FILES]}}\nmetrics:")
    edit(path, "FILES", "'observer.py:Observer', 'same.py:Observer'")
    with pytest.raises(ConfigError, match="has no effect: observer.py:Observer and same.py:Observer give the same"):
        load_config(path)
    edit(path, "same.py", "slow.py")
    config = load_config(path)
    first, slow = (point.method_keys["One"] for point in config.points)
    assert first != slow
    out = tmp_path / "out"
    assert run(path, out).exit_code == 0
    resolved = load_config(out / "config.resolved.yaml")
    assert [point.method_keys for point in resolved.points] == [point.method_keys for point in config.points]
    edit(tmp_path / "slow.py", "0.5 *", "0.25 *")
    result = run(path, out, "-n")
    assert "One: slow.py has changed since 2 runs were stored: they would be computed again" in result.stdout
