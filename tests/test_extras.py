"""Optional libraries: the extras of pip, the kinds that need one, and what is said where one is missing."""

import ast
import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from missing_libraries import hidden_in_children, hide
from own_experiment import CONFIG, write_own
from small_experiment import cli, write

from rmpc_bench import extras, load_config, registry
from rmpc_bench.types import ConfigError

ROOT = Path(__file__).parents[1]
OPTIONAL = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
MESSAGE = "the library filterpy is not installed; make setup EXTRAS=dev,filterpy installs it"
AT_IMPORT = """
import numpy as np
import filterpy.kalman

from rmpc_bench import single_run


@single_run
class Filter:
    def start(self, x0): self.x = x0
    def update(self, y): return self.x
"""
IN_A_CALL = """
from rmpc_bench import single_run
from rmpc_bench.extras import library


@single_run
class Filter:
    def start(self, x0): self.x = x0

    def update(self, y, k):
        if k >= {k}:
            {line}
        return self.x
"""
METHODS = "methods: {A: {estimator: {file: mine.py:Filter}}, B: {estimator: {kind: kalmann}}}\nmetrics"


def with_file(directory, module, methods="methods: {A: {estimator: {file: mine.py:Filter}}}\nmetrics"):
    """Write a configuration with an estimator from a file."""
    first, rest = CONFIG.split("methods:")
    return write_own(directory, module=module, config=first + methods + rest.partition("metrics")[2])


def errors(path):
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    return str(caught.value).splitlines()


def test_every_extra_can_be_installed_and_is_one_of_all():
    assert {*extras.EXTRAS} <= {*OPTIONAL}
    assert OPTIONAL["adapters"] == [f"rmpc-bench[{','.join(extras.EXTRAS)}]"]


def test_the_command_that_installs_an_extra(monkeypatch):
    """In a clone, where the package is installed before and after its release, and in no other words anywhere."""
    assert extras.install("dask", "pack") == "make setup EXTRAS=dev,dask,pack"
    monkeypatch.setattr(extras, "__file__", "/nowhere/site/rmpc_bench/extras.py")
    assert extras.missing("pack").endswith("rocrate is not installed; pip install '.[pack]' in a clone installs it")
    monkeypatch.setattr(extras, "RELEASED", True)
    assert extras.install("do-mpc") == "pip install 'rmpc-bench[do-mpc]'"
    files = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
    files += [path for folder in ("rmpc_bench", "configs") for path in sorted((ROOT / folder).rglob("*.*"))]
    texts = {path.name: path.read_bytes() for path in files if path.suffix != ".pyc"}
    assert [name for name, text in texts.items() if re.search(rb"pip install '(rmpc-bench|\.)\[", text)] == [
        "extras.py"
    ]


def test_every_test_file_that_imports_one_is_skipped_without_it():
    """pytest imports test files, and these the files beside them; an import that fails would end `make test`."""
    development = " ".join(OPTIONAL["dev"])
    modules = {module for extra, module in extras.EXTRAS.items() if f"{extra}>=" not in development}
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        text = path.read_text("utf-8")
        found = [node for node in ast.parse(text).body if isinstance(node, ast.Import | ast.ImportFrom)]
        names = {alias.name for node in found if isinstance(node, ast.Import) for alias in node.names}
        names |= {node.module for node in found if isinstance(node, ast.ImportFrom) and not node.level}
        needed = {name.partition(".")[0] for name in names} & modules
        assert all(f'importorskip("{name}' in text or "is not installed" in text for name in needed), (path, needed)


def test_every_kind_that_needs_a_library_is_built_in():
    for (group, kind), extra in extras.NEEDED_BY.items():
        assert kind in registry.BUILT_IN[group] and extra in extras.EXTRAS


def test_an_extra_is_recognised_by_the_error_of_an_import(monkeypatch):
    """Only of a library that is not there: another error of an import has another reason."""
    hide(monkeypatch, "do_mpc")
    for statement in ("import do_mpc", "from do_mpc.controller import MPC"):
        with pytest.raises(ImportError) as caught:
            exec(statement)  # noqa: S102
        assert extras.missing_extra(caught.value) == "do-mpc"
    with pytest.raises(extras.MissingLibraryError, match="library do_mpc is not installed") as caught:
        extras.library("do-mpc", "controller")
    assert extras.missing_extra(caught.value) == "do-mpc"
    monkeypatch.setattr(extras, "is_installed", lambda extra: True)
    for error in (ModuleNotFoundError(name="do_mpc.mpc"), ModuleNotFoundError(name="x"), ImportError(), KeyError("x")):
        assert extras.missing_extra(error) == ""


def test_a_built_in_kind_without_its_library(tmp_path, monkeypatch):
    """One line at the key that gives the kind, with all other errors of the file; nothing is imported."""
    hide(monkeypatch, "filterpy")
    monkeypatch.setitem(extras.NEEDED_BY, ("estimators", "kalman"), "filterpy")
    monkeypatch.setitem(extras.NEEDED_BY, ("plants", "ode"), "filterpy")
    get = registry.get
    monkeypatch.setattr(registry, "get", lambda group, kind: pytest.fail(kind) if kind == "ode" else get(group, kind))
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path, plant="{ode: no.py:rhs, perturb: {J_l: 1 + eps}}", runs="0")
    assert errors(path.name)[:3] == [
        "tiny.yaml:4:7: runs: must be >= 1 (got 0)",
        f"tiny.yaml:7:9: plant.ode: {MESSAGE}",
        f"tiny.yaml:13:37: methods.S-MPC.estimator.kind: {MESSAGE}",
    ]


def test_such_a_kind_is_listed_and_described(monkeypatch):
    monkeypatch.setitem(extras.NEEDED_BY, ("estimators", "kalman"), "filterpy")
    hide(monkeypatch, "filterpy")
    needs = "kalman  needs the extra filterpy, which is not installed"
    assert re.search(
        r"^ kalman +linear gaps +needs rmpc-bench\[filterpy\]$", cli("list", "estimators").stdout, re.MULTILINE
    )
    assert cli("describe", "estimators/kalman").stdout.startswith(f"estimators/{needs}\n")
    monkeypatch.setattr(extras, "is_installed", lambda extra: True)
    assert "needs rmpc-bench[filterpy]" not in cli("list", "estimators").stdout


def test_a_file_that_imports_it(tmp_path, monkeypatch):
    """The place is that of the key, with the line of the file in the message; other errors are shown, too."""
    hide(monkeypatch, "filterpy")
    monkeypatch.chdir(tmp_path)
    found = errors(with_file(tmp_path, AT_IMPORT, METHODS).name)
    assert found[0] == f"own.yaml:12:33: methods.A.estimator.file: mine.py:3: {MESSAGE}"
    assert "'kalmann' is not a known estimator" in found[1] and len(found) == 2
    described = cli("describe", "mine.py:Filter")
    assert described.exit_code == 2 and f"mine.py:3: {MESSAGE}" in described.stderr
    path = tmp_path / "own.yaml"
    path.write_text(path.read_text().replace("kalmann", "kalman").replace("seed:", "requires: [filterpy]\nseed:"))
    # What `requires` says is not said again.
    assert errors(path.name) == [f"own.yaml:4:12: requires.0: {MESSAGE}"]


def test_a_plugin_that_imports_it(tmp_path, monkeypatch):
    hide(monkeypatch, "filterpy")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "parts.py").write_text("import filterpy\n")
    path = write(tmp_path, plugins="[parts.py]")
    assert errors(path.name) == [f"tiny.yaml:16:11: plugins.0: parts.py:1: {MESSAGE}"]


@pytest.mark.parametrize("line", ["library('filterpy', 'kalman')", "import filterpy"])
def test_a_function_that_imports_it_at_check(tmp_path, line):
    """The first call of `check` is in a process of its own."""
    with_file(tmp_path, IN_A_CALL.format(k=0, line=line))
    environment = hidden_in_children(tmp_path / "site", "filterpy")
    command = [sys.executable, "-m", "rmpc_bench", "check", "own.yaml"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 2
    assert f"own.yaml:12:26: methods.A.estimator: mine.py:12: {MESSAGE}" in done.stdout + done.stderr


def test_a_function_that_imports_it_during_a_run(tmp_path):
    """The file of the failure says which extra is missing."""
    with_file(tmp_path, IN_A_CALL.format(k=5, line="import filterpy"))
    environment = hidden_in_children(tmp_path / "site", "filterpy")
    command = [sys.executable, "-m", "rmpc_bench", "run", "own.yaml", "--runs", "2", "-o", "out"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and MESSAGE in " ".join(done.stdout.split()), done.stderr
    text = (tmp_path / "out" / "failures" / "A-0.txt").read_text()
    assert f"\nreason      {MESSAGE}\n" in text and "ModuleNotFoundError: import" in text


def test_the_version_of_an_extra_is_known():
    """A version that is not found would never be refused."""
    from rmpc_bench.components.reference import distribution_of

    present = [module for extra, module in extras.EXTRAS.items() if extras.is_installed(extra)]
    for module in present:
        name, version = distribution_of(module)
        assert importlib.metadata.version(name) == version
