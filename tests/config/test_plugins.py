"""The section `requires`: unknown names, missing libraries, inheritance; it identifies nothing and imports nothing."""

import subprocess
import sys
from pathlib import Path

import pytest
from missing_libraries import hide, skip_without_libraries
from small_experiment import cli, write

from rmpc_bench import extras, load_config
from rmpc_bench.config.plugins import missing_extras
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.types import ConfigError

ROOT = Path(__file__).parents[2]
LOADED = """
import sys
from rmpc_bench import load_config
from rmpc_bench.extras import EXTRAS
load_config(sys.argv[1])
print(*{name.partition(".")[0] for name in sys.modules} & {*EXTRAS.values()})
"""


def install(monkeypatch, *names):
    """Let exactly these extras look installed."""
    monkeypatch.setattr(extras, "is_installed", lambda name: name in names)


def errors(path):
    with pytest.raises(ConfigError) as caught:
        load_config(path.name)
    return str(caught.value).splitlines()


def test_a_missing_library_names_its_extra(tmp_path, monkeypatch):
    hide(monkeypatch, "filterpy", "do_mpc")
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path, requires="[filterpy, do-mpc]", runs="0")
    place = "tiny.yaml:{}: requires.{}: the library {} is not installed; make setup EXTRAS=dev,{} installs it"
    assert errors(path) == [
        "tiny.yaml:4:7: runs: must be >= 1 (got 0)",
        place.format("16:12", 0, "filterpy", "filterpy"),
        place.format("16:22", 1, "do_mpc", "do-mpc"),
    ]
    done = cli("check", path)
    assert done.exit_code == 2 and "Traceback" not in done.output


def test_an_unknown_name_has_the_nearest_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert errors(write(tmp_path, requires="[do_mpc]")) == [
        "tiny.yaml:16:12: requires.0: 'do_mpc' is not a known optional library; did you mean 'do-mpc'?"
    ]
    assert errors(write(tmp_path, requires="filterpy")) == [
        "tiny.yaml:16:11: requires: must be a list (got 'filterpy')"
    ]
    assert errors(write(tmp_path, requires="[3]")) == ["tiny.yaml:16:12: requires.0: must be text (got 3)"]


def test_a_name_is_given_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    install(monkeypatch, "filterpy")
    assert errors(write(tmp_path, requires="[filterpy, filterpy]")) == [
        "tiny.yaml:16:22: requires.1: 'filterpy' is named twice"
    ]


def test_it_is_kept_and_identifies_nothing(tmp_path, monkeypatch):
    install(monkeypatch, "filterpy")
    without, given = load_config(write(tmp_path)), load_config(write(tmp_path, requires="[filterpy]"))
    assert (given.hash, given.full_hash) == (without.hash, without.full_hash)
    assert "requires" not in without.resolved and given.resolved["requires"] == ["filterpy"]
    (tmp_path / "again.yaml").write_text(dump(plain(given.resolved)), encoding="utf-8")
    assert load_config(tmp_path / "again.yaml").resolved == given.resolved


def test_an_inherited_list_is_joined(tmp_path, monkeypatch):
    """Each entry keeps the place at which it stands; `!delete` and an option replace the list."""
    monkeypatch.chdir(tmp_path)
    install(monkeypatch, "filterpy", "control", "do-mpc")
    write(tmp_path, requires="[filterpy, control]")
    own = tmp_path / "own.yaml"
    own.write_text("extends: tiny.yaml\nname: own\nrequires: [do-mpc, filterpy]\n")
    assert load_config(own).resolved["requires"] == ["do-mpc", "filterpy", "control"]
    install(monkeypatch, "do-mpc")
    assert [line.partition(": the")[0] for line in errors(own)] == [
        "own.yaml:3:20: requires.1",
        "tiny.yaml:16:22: requires.2",
    ]
    assert load_config(own, overrides=["requires=[do-mpc]"]).resolved["requires"] == ["do-mpc"]
    own.write_text("extends: tiny.yaml\nname: own\nrequires: !delete\n")
    assert "requires" not in load_config(own).resolved


def test_what_is_missing_is_found_without_loading(tmp_path, monkeypatch):
    """For `run --skip-missing` and the tests; the own file of the configuration is not loaded."""
    path = write(tmp_path, requires="[do-mpc, filterpy, tensorflow]", plugins="[no_such_file.py]")
    install(monkeypatch, "filterpy")
    assert missing_extras(path) == ["do-mpc"]
    assert missing_extras(write(tmp_path)) == []


def test_a_required_library_is_not_imported(tmp_path):
    pytest.importorskip("filterpy")
    path = write(tmp_path, requires="[filterpy]")
    done = subprocess.run([sys.executable, "-c", LOADED, str(path)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_run_skips_by_name_on_request(tmp_path, monkeypatch):
    """As `make smoke` does; without the option the same file is an error."""
    monkeypatch.chdir(tmp_path)
    install(monkeypatch, "filterpy")
    path = write(tmp_path, requires="[do-mpc, filterpy, control]").name
    done = cli("run", path, "--if-installed", "--smoke")
    assert (done.exit_code, done.stdout) == (0, "") and not (tmp_path / "results").exists()
    assert done.stderr == "skipped tiny.yaml: needs do-mpc, control (make setup EXTRAS=dev,do-mpc,control)\n"
    assert cli("run", path).exit_code == 2
    install(monkeypatch, "filterpy", "do-mpc", "control")
    done = cli("run", path, "--if-installed", "--dry-run")
    assert done.exit_code == 0 and "12 of 12 trials to compute" in done.stdout


def test_make_and_the_tests_skip_them():
    """`make smoke` uses the option, and every configuration whose files need an extra says so."""
    makefile = (ROOT / "Makefile").read_text("utf-8")
    assert "--smoke --fresh --if-installed" in makefile and ".installed-$(EXTRAS)" in makefile
    assert "EXTRAS=dev,adapters" in (ROOT / ".ci" / "run").read_text("utf-8")


@pytest.mark.parametrize("path", sorted((ROOT / "configs" / "examples").glob("*.yaml")), ids=lambda path: path.stem)
def test_an_example_requires_what_it_uses(path):
    """The libraries of its kinds and files are under `requires`, and no others; do-mpc brings CasADi."""
    skip_without_libraries(path)
    config = load_config(path, smoke=True)
    optional = {*extras.EXTRAS.values()}
    used = {name for point in config.points for names in point.modules.values() for name in names} & optional
    named = {extras.EXTRAS[extra] for extra in config.resolved.get("requires", ())}
    implied = {extras.COMPUTES_WITH[name] for name in used if name in extras.COMPUTES_WITH}
    assert named <= used and used - implied <= named
