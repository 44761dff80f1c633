"""The wheel: it has every package, the configurations and the templates, and works without the checkout."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Directory into which the wheel of a copy of the sources is installed; a build leaves files beside them."""
    source, place = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("site")
    for name in ("rmpc_bench", "configs"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--no-compile", "--target", str(place), str(source)], check=True)
    return place


def call(place, directory, *arguments):
    """Call the installed program in another directory; the checkout is not on its path."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(
        [sys.executable, "-P", "-m", "rmpc_bench", *arguments],
        cwd=directory,
        env={**environment, "PYTHONPATH": str(place)},
        capture_output=True,
        text=True,
    )


def test_every_file_is_in_the_wheel(installed):
    ignored = {"__pycache__"}
    for folder, inside in ((ROOT / "rmpc_bench", "rmpc_bench"), (ROOT / "configs", "rmpc_bench/configs")):
        wanted = {
            path.relative_to(folder) for path in folder.rglob("*") if path.is_file() and not ignored & {*path.parts}
        }
        missing = {path for path in wanted if not (installed / inside / path).is_file()}
        assert missing == set()


def test_names_without_a_checkout(installed, tmp_path):
    done = call(installed, tmp_path, "list", "configs")
    assert done.stdout.split() == sorted(
        path.relative_to(ROOT).as_posix() for path in (ROOT / "configs").rglob("*.yaml")
    )
    done = call(installed, tmp_path, "describe", "souto2011/fig4")
    assert done.returncode == 0 and str(installed) in done.stdout.splitlines()[0]


@pytest.mark.long
def test_quickstart_without_a_checkout(installed, tmp_path):
    """By its name; the results are in the current directory, and the installation gets no file but bytecode."""
    before = {path for path in installed.rglob("*") if path.is_file()}
    done = call(installed, tmp_path, "run", "quickstart", "--runs", "4", "-j", "1")
    assert done.returncode == 0, done.stderr
    assert "mean MSE [rad^2]" in done.stdout
    assert (tmp_path / "results" / "quickstart" / "report.html").is_file()
    new = {path for path in installed.rglob("*") if path.is_file()} - before
    assert {path.parent.name for path in new} <= {"__pycache__"}
    assert {path.suffix for path in new} <= {".pyc", ".nbi", ".nbc"}


def test_a_plant_of_an_installed_configuration(installed, tmp_path):
    text = "version: 1\nname: own\nruns: 2\ntime: {steps: 5}\nplant: {from: configs/benchmarks/souto2011.yaml}\n"
    text += "methods: {KF: {estimator: {kind: kalman}}}\nmetrics: [estimation_mse]\n"
    (tmp_path / "own.yaml").write_text(text, encoding="utf-8")
    done = call(installed, tmp_path, "check", "own.yaml")
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_read_only_installation_and_home(installed, tmp_path):
    """No cache of compiled code is possible: one line says so.  Root loses the capability to write everywhere."""
    as_root = ["setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner"] if os.geteuid() == 0 else []
    if as_root and shutil.which(as_root[0]) is None:
        pytest.skip("root may write everywhere, and there is no setpriv")
    site, home, work = (tmp_path / name for name in ("site", "home", "work"))
    shutil.copytree(installed, site, ignore=shutil.ignore_patterns("__pycache__"))
    home.mkdir()
    work.mkdir()
    folders = [home, site, *(path for path in site.rglob("*") if path.is_dir())]
    environment = {
        name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")
    }
    environment |= {"HOME": str(home), "PYTHONPATH": str(site)}
    try:
        for folder in folders:
            folder.chmod(0o555)
        assert subprocess.run([*as_root, "touch", str(site / "x")], capture_output=True).returncode != 0
        command = [*as_root, sys.executable, "-P", "-m", "rmpc_bench", "run", "quickstart", "--runs", "4"]
        done = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True)
    finally:
        for folder in folders:
            folder.chmod(0o755)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("NUMBA_CACHE_DIR") == 1
    assert (work / "results" / "quickstart" / "report.html").is_file()
    assert not [*site.rglob("*.nb?"), *home.rglob("*")]
