"""What a type checker sees of the public names: programs of users are checked, and their mistakes found."""

import ast
import sys
from pathlib import Path

import pytest

import rmpc_bench

ROOT = Path(__file__).parents[2]
PROGRAM, MISTAKES = (Path(__file__).with_name(f"user_{name}.py") for name in ("program", "mistakes"))


@pytest.fixture(scope="module")
def report():
    """Return the lines that mypy --strict writes about both programs; its cache is the one of `make type`."""
    from mypy import api

    config = ("--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(ROOT / ".mypy_cache"))
    options = ("--strict", "--no-error-summary", "--no-pretty", "--python-executable", sys.executable, *config)
    out, err, _ = api.run([*options, str(PROGRAM), str(MISTAKES)])
    assert not err
    return out.splitlines()


def _uses(path):
    """Names that a program imports from the package."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == "rmpc_bench"]
    return {alias.name for node in found for alias in node.names}


def test_a_program_with_every_public_name_passes(report):
    """No name is `Any`, and none is missing."""
    assert _uses(PROGRAM) == set(rmpc_bench.__all__)
    assert [line for line in report if "user_program.py" in line] == []


def test_ten_mistakes_are_found(report):
    """These lines, and no other one."""
    lines = MISTAKES.read_text(encoding="utf-8").splitlines()
    planted = {number for number, line in enumerate(lines, start=1) if line.endswith("# wrong")}
    found = {int(line.split(":")[1]) for line in report if "user_mistakes.py" in line and ": error:" in line}
    assert len(planted) == 10 and found == planted, report


def test_all_lists_the_public_names():
    """Those that `import *` gives: what is loaded at its first use, and the version of the numbers."""
    assert sorted(rmpc_bench.__all__) == sorted([*rmpc_bench._PUBLIC, "NUMERICS"])
    names: dict[str, object] = {}
    exec("from rmpc_bench import *", names)
    assert set(names) - {"__builtins__"} == set(rmpc_bench.__all__)
    assert names["run"] is rmpc_bench.run
