"""Loading a configuration: the order of its stages, and all errors of a file at once."""

import ast
import inspect
import re

import pytest
from small_experiment import write

import rmpc_bench.config
from rmpc_bench import load_config
from rmpc_bench.config import build, check, load, sweep, validate
from rmpc_bench.config_file import extends, inherit
from rmpc_bench.types import ConfigError

STAGES = {  # public function of a stage -> its module
    "read": extends,
    "inherit": inherit,
    "expand": sweep,
    "validate_sections": validate,
    "build": build,
    "check": check,
    "canonicalise": load,
}
BESIDE = {  # module -> its other public functions
    sweep: {"columns", "assigned"},
    check: {"check_report", "check_statistics"},
    load: {"load_config"},
}


def test_load_config_calls_every_stage_once_and_in_order():
    """Nothing else is called but what collects errors; inherited metrics that do not fit repeat the later stages."""
    text = inspect.getsource(load.load_config) + inspect.getsource(load._validated)
    calls = [node.func for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    called = [each.id for each in calls if isinstance(each, ast.Name)]
    places = [re.search(rf"\b{name}\((?!self)", text).start() for name in STAGES]
    assert places == sorted(places)
    assert sorted(name for name in called if name in STAGES) == sorted(STAGES)
    others = {"bool", "len", "problems_at_origin", "with_findings", "with_matrices", "load_plugins", "ConfigError"}
    others |= {"OwnCode", "Size", "Inherited", "fitting_sweep", "fitting_metrics", "texts_of", "_validated"}
    others |= {"located", "reported_once"}
    # Values that tuning chooses: what is refused, what there is to choose, and the same stages with the chosen ones.
    others |= {"check_tuning", "with_tuning", "Origin", "partial", "check_copies"}
    # Arguments are checked, and a mapping becomes a text.
    others |= {"check_arguments", "locals", "isinstance", "int", "Problem", "_texts", "canonical_text", "replace"}
    assert set(called) - set(STAGES) <= others


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_is_one_public_function_of_a_module(stage):
    """And the first lines of the room name the module; those of `config_file` have what others read files with, too."""
    module = STAGES[stage]
    functions = [name for name, each in vars(module).items() if inspect.isfunction(each)]
    own = [name for name in functions if getattr(module, name).__module__ == module.__name__]
    public = [name for name in own if not name.startswith("_")]
    assert stage in public
    assert "config_file" in module.__name__ or {*public} == {stage} | BESIDE.get(module, set())
    assert f"{module.__name__.rpartition('.')[2]}.py" in rmpc_bench.config.__doc__


def problems(path, **keys):
    """Return path and message of every error."""
    with pytest.raises(ConfigError) as caught:
        load_config(path, **keys)
    return [(problem.path, problem.message) for problem in caught.value.problems]


def test_every_file_that_cannot_be_read_is_reported(tmp_path):
    """Those of the plant and of the sweep together."""
    path = write(tmp_path, plant="{from: a.yaml}", sweep="{grid: {plant.from: [b.yaml, c.yaml]}}")
    found = problems(path)
    assert [each for each, _ in found] == ["plant.from"] * 3
    assert ["a.yaml" in found[0][1], "b.yaml" in found[1][1], "c.yaml" in found[2][1]] == [True] * 3


def test_errors_of_overrides_are_reported_together(tmp_path):
    """One that is no assignment, one that does not fit the file."""
    found = problems(write(tmp_path), overrides=["runs", "seed.x=1"])
    assert [message.split(";")[0] for _, message in found] == ["expected PATH=VALUE", "is 7"]


def test_a_point_that_cannot_be_composed_hides_no_other_error(tmp_path):
    """A model that comes from nowhere at one point, and wrong runs at all of them."""
    path = write(tmp_path, sweep="{grid: {model.from: [plant, moon]}}", runs=0)
    assert [each for each, _ in problems(path)] == ["runs", "model.from"]
