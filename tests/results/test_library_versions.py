"""Versions of the libraries of adapters and built-in components: stored, and refused where they have changed."""

import json

import pytest
from small_experiment import cli, write

from rmpc_bench import extras, load_config
from rmpc_bench.results import other_code

THROUGH_THE_BENCH = """
from rmpc_bench import single_run
from rmpc_bench.extras import library


@single_run
class Filter:
    def start(self, x0): self.x = x0
    def update(self, y): return self.x
    def unused(self): return library("do-mpc")
"""
METHODS = {
    "file": "{KF: {estimator: {kind: kalman}}, A: {estimator: {file: mine.py:Filter}}}",
    "built-in": "{KF: {estimator: {kind: kalman}}, A: {estimator: {kind: robust-kalman, c: 0.1}}}",
}


def run(path, *options):
    return cli("run", path, "-o", path.parent / "out", "--engine", "serial", "--runs", "2", *options)


@pytest.mark.parametrize("kind", METHODS)
def test_another_version_is_refused(tmp_path, monkeypatch, kind):
    """Of the library itself, and of one that changes its numbers; methods that do not use it are not named."""
    monkeypatch.setitem(extras.NEEDED_BY, ("estimators", "robust-kalman"), "do-mpc")
    monkeypatch.setattr(extras, "is_installed", lambda extra: True)
    found = {"do_mpc": ("do-mpc", "5.1.2"), "casadi": ("casadi", "3.8.2")}
    monkeypatch.setattr(other_code, "distribution_of", found.get)
    (tmp_path / "mine.py").write_text(THROUGH_THE_BENCH)
    path = write(tmp_path, methods=METHODS[kind])
    modules = load_config(path).points[0].modules
    assert not {"do_mpc", "casadi"} & {*modules["KF"]} and {"do_mpc", "casadi"} <= {*modules["A"]}
    assert run(path).exit_code == 0
    stored = json.loads((tmp_path / "out" / "manifest.json").read_text())["libraries"]
    assert stored == {"do-mpc": "5.1.2", "casadi": "3.8.2"}

    found["do_mpc"] = ("do-mpc", "5.1.9")
    assert run(path).exit_code == 0
    found["casadi"] = ("casadi", "3.9.0")
    result = run(path)
    assert result.exit_code == 5 and "--accept-versions uses these rows" in result.stderr
    assert "A: 2 stored runs were computed with casadi 3.8.2; here casadi 3.9.0" in result.stderr
    assert "KF:" not in result.stderr
    assert run(path, "--accept-versions").exit_code == 0
    assert run(path).exit_code == 0


def test_a_missing_library_of_stored_results(tmp_path, monkeypatch):
    """`report` needs no library; its version is that of the manifest."""
    monkeypatch.setitem(extras.NEEDED_BY, ("estimators", "robust-kalman"), "filterpy")
    monkeypatch.setattr(extras, "is_installed", lambda extra: True)
    path = write(tmp_path, methods=METHODS["built-in"])
    assert run(path).exit_code == 0
    monkeypatch.setattr(extras, "is_installed", lambda extra: False)
    assert run(path, "--runs", "3").exit_code == 2
    result = cli("report", tmp_path / "out")
    assert result.exit_code == 0 and "A" in result.stdout
