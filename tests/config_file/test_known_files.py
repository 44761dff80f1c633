"""Configurations by name: those of the current directory, and those that are installed with the package."""

from pathlib import Path

import pytest
from small_experiment import cli, write

from rmpc_bench import load_config
from rmpc_bench.config_file.known_files import installed_folder, known_configs, located
from rmpc_bench.types import ConfigError

FIG7 = "configs/zenere2018/fig7.yaml"
PENDULUM = "configs/examples/pendulum.yaml"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A current directory without configurations."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_installed_ones_are_those_of_the_checkout():
    root = Path(__file__).parents[2]
    assert installed_folder() == root / "configs"
    assert known_configs() == sorted(str(path.relative_to(root)) for path in (root / "configs").rglob("*.yaml"))


@pytest.mark.parametrize("name", [FIG7, f"./{FIG7}", "zenere2018/fig7", "fig7"])
def test_an_installed_configuration_by_its_name(name):
    config = load_config(name)
    assert (config.name, config.path) == ("fig7", installed_folder() / "zenere2018" / "fig7.yaml")


def test_a_file_comes_before_a_name(elsewhere):
    """A file of the current directory is never replaced by an installed one."""
    write(elsewhere, file="fig7")
    assert located("fig7") == Path("fig7")
    (elsewhere / "configs" / "own").mkdir(parents=True)
    write(elsewhere / "configs" / "own", file="fig8.yaml")
    assert located("fig8") == Path("configs/own/fig8.yaml")
    assert located("zenere2018/fig8") == installed_folder() / "zenere2018" / "fig8.yaml"
    assert {"configs/own/fig8.yaml", "configs/zenere2018/fig8.yaml"} <= {*known_configs()}


def test_a_missing_file_is_not_replaced_by_an_installed_one(elsewhere):
    """A file name with its ending is a file of the user, and so is a place that is not below configs."""
    for path in ("fig7.yaml", "zenere2018/fig7.yaml", elsewhere / "configs" / "zenere2018" / "fig7.yaml"):
        with pytest.raises(ConfigError, match="fig7.yaml:1:1: there is no such file"):
            load_config(path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("quickstrat", "quickstrat:1:1: there is no such file; did you mean 'quickstart'? (rmpc-bench list configs)"),
        ("configs/zenere2018/fig77.yaml", f"fig77.yaml:1:1: there is no such file; did you mean '{FIG7}'?"),
        ("fig4", "may be any of "),
        ("qqqqqq", "qqqqqq:1:1: there is no such file (rmpc-bench list configs)"),
    ],
)
def test_an_unknown_name(name, message):
    result = cli("run", name)
    assert result.exit_code == 2 and message in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_directory_is_no_configuration(elsewhere):
    (elsewhere / "results").mkdir()
    with pytest.raises(ConfigError, match="is a directory"):
        load_config("results")


@pytest.mark.parametrize("source", ["configs/benchmarks/souto2011.yaml", "benchmarks/souto2011", "wang2021"])
def test_the_plant_of_an_installed_configuration(elsewhere, source):
    text = f"version: 1\nname: own\nruns: 2\ntime: {{steps: 5}}\nplant: {{from: {source}}}\n"
    text += "methods: {KF: {estimator: {kind: kalman}}}\nmetrics: [estimation_mse]\n"
    (elsewhere / "own.yaml").write_text(text, encoding="utf-8")
    config = load_config("own.yaml")
    plant = load_config(source.removeprefix("configs/").removesuffix(".yaml")).experiment.plant
    assert repr(config.experiment.plant) == repr(plant)


def test_an_installed_configuration_is_extended(elsewhere):
    """Files that it names are relative to it."""
    (elsewhere / "own.yaml").write_text(f"extends: {PENDULUM}\nname: own\nruns: 3\n", encoding="utf-8")
    code = installed_folder() / "examples"
    config = load_config("own.yaml", allow_code=[code])
    assert (config.name, config.experiment.n_runs) == ("own", 3)
    assert {path.name for path in config.own.sources} == {"pendulum.py"}


def test_a_local_file_comes_before_the_installed_one_in_extends(elsewhere):
    (elsewhere / "quickstart").write_text("runs: nothing\n", encoding="utf-8")
    (elsewhere / "own.yaml").write_text("extends: quickstart\nname: own\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="runs: "):
        load_config("own.yaml")
