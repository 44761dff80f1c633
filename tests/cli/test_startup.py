"""What a verb imports, as sets of modules: times depend on the machine, these do not."""

import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from small_experiment import cli

from rmpc_bench import __version__
from rmpc_bench.extras import EXTRAS, NEEDED_BY

FIG7 = Path(__file__).parents[2] / "configs" / "zenere2018" / "fig7.yaml"
IMPORTED = """
import sys
from rmpc_bench.cli import main
try:
    main(sys.argv[1:], prog_name="rmpc-bench")
except SystemExit as done:
    assert not done.code, done.code
print(*{name.split(".")[0] for name in sys.modules}, file=sys.stderr)
"""
HEAVY = {"numpy", "scipy", "pydantic", "numba", "pandas", "matplotlib", "joblib", "rich", "yaml"}


@cache
def imported(*arguments):
    """Packages that a command imports in a process of its own; several tests look at the same ones."""
    command = [sys.executable, "-c", IMPORTED, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return frozenset(done.stderr.split())


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["list"]])
def test_help_imports_nothing(arguments):
    """Help, version and the list of names cost nothing but click."""
    assert imported(*arguments) & HEAVY == set()


def test_help_of_a_verb_imports_nothing():
    """The work is imported when it is done."""
    assert imported("run", "--help") & HEAVY == set()


def test_check_imports_no_simulation():
    """Neither the compiler nor pandas nor matplotlib, though the claims are read and all designs made."""
    assert imported("check", FIG7) & HEAVY <= {"numpy", "scipy", "pydantic", "yaml"}


@pytest.mark.parametrize(
    "arguments",
    [
        *(["--help"], ["list"], ["check", FIG7], ["schema"], ["describe", "estimators/kalman"]),
        *(["describe", f"{group}/{kind}"] for group, kind in NEEDED_BY),
    ],
    ids=lambda arguments: "-".join(map(str, arguments[:2])).rpartition("/")[2],
)
def test_no_optional_library_is_imported(arguments):
    """Also not where a component that needs one is listed and described."""
    assert imported(*arguments) & {*EXTRAS.values()} == set()


@pytest.mark.long
def test_neither_pandas_nor_an_optional_library_is_imported_for_built_in_components(tmp_path, monkeypatch):
    """Run and report of a configuration that uses none; tables are plain until a user asks for a data frame."""
    monkeypatch.chdir(tmp_path)
    for arguments in (["run", "quickstart", "--runs", "4", "--no-report"], ["report", "results/quickstart"]):
        assert imported(*arguments) & {"pandas", *EXTRAS.values()} == set()


def test_installed_command():
    """The entry point is the same program."""
    command = Path(sys.executable).with_name("rmpc-bench")
    done = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"rmpc-bench, version {__version__}\n"


def test_help_shows_every_verb():
    """In the order of a day's work, each with a line; each has help of its own."""
    verbs = [
        *("init", "run", "import", "suite", "check", "list", "describe", "status"),
        *("merge", "show", "report", "compare", "pack", "verify", "schema"),
    ]
    lines = [line.split(maxsplit=1) for line in cli("--help").stdout.split("Commands:")[1].splitlines() if line.strip()]
    assert [name for name, _ in lines] == verbs
    assert all(cli(verb, option).stdout.startswith("Usage: ") for verb in verbs for option in ("-h", "--help"))


@pytest.mark.parametrize(
    "arguments", [["rnu"], ["run"], ["run", "a.yaml", "--rnus", "3"], ["check"], ["list", "plant"]]
)
def test_wrong_usage(arguments):
    """Exit 2 and a word of what is wrong."""
    result = cli(*arguments)
    assert result.exit_code == 2
    assert "Error:" in result.stderr and "Traceback" not in result.stderr
