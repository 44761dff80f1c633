"""The examples on the pages of components: each names its kind and passes `check`."""

import shutil

import pytest
from click.testing import CliRunner
from docs.components_page import pages
from docs.examples_of_kinds import examples, named, users

from rmpc_bench import registry
from rmpc_bench.cli import main
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load
from rmpc_bench.extras import NEEDED_BY, is_installed

KINDS = [(group, kind) for group, kinds in registry.BUILT_IN.items() for kind in kinds]


def test_every_kind_has_an_example_or_a_shipped_configuration():
    assert [each for each in KINDS if each not in examples() and each not in users()] == []


@pytest.mark.parametrize(("group", "kind"), examples())
def test_an_example_is_valid(group, kind, tmp_path):
    extra = NEEDED_BY.get((group, kind))
    if extra and not is_installed(extra):
        pytest.skip(f"needs {extra}")
    if kind == "fmu":
        if shutil.which("gcc") is None:
            pytest.skip("the unit is compiled")
        from adapters.fmu_units import build

        build(tmp_path, 2).rename(tmp_path / "tanks.fmu")
    for name, text in {**examples()[group, kind].files, "example.yaml": examples()[group, kind].text}.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert (group, kind) in {*named(plain(load(tmp_path / "example.yaml")))}
    done = CliRunner().invoke(main, ["check", str(tmp_path / "example.yaml")])
    assert done.exit_code == 0, done.output


def test_kinds_are_found_in_lists_short_forms_and_values():
    tree = {
        "plant": {"ode": "a.py:f"},
        "noise": {"w": {"sum": [{"gaussian": {}}]}},
        "metrics": ["mse", {"kind": "nees"}],
    }
    assert [*named(tree)] == [("plants", "ode"), ("noises", "gaussian"), ("metrics", "mse"), ("metrics", "nees")]
    assert len(pages()) > 100
