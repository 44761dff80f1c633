"""The section `requires`: unknown names, missing libraries, inheritance; it identifies nothing and imports nothing."""

import subprocess
import sys

import pytest
from missing_libraries import hide
from small_experiment import cli, write

from rmpc_bench import extras, load_config
from rmpc_bench.config.required_libraries import missing_extras
from rmpc_bench.config.tree import plain
from rmpc_bench.config.writer import dump
from rmpc_bench.types import ConfigError

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
    place = "tiny.yaml:{}: requires.{}: the library {} is not installed; pip install 'rmpc-bench[{}]' installs it"
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
