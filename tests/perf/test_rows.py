"""Both sides of every row of the table compute the same numbers, at a small size and without a clock."""

import sys

import pytest

from perf import __main__ as perf
from perf import commands

SMALL = {"RUNS": 4, "BLOCK": 4, "MANY": 40, "RUNS_OF_TANKS": 4, "RUNS_OF_JOBLIB": 2, "RUNS_STORED": 8}
SMALL |= {"STEPS_OF_ROBOT": 20, "SHORT": 20}
"""Sizes in the modules of rows."""
LONG = [row for row in perf.ROWS if "workers" in row.name or (row in commands.ROWS and row.unit == "call")]
"""Rows of workers and of commands, each of which takes seconds."""


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "row",
    [pytest.param(row, marks=[pytest.mark.slow] * (row in LONG), id=f"{row.name}-{row.beside}") for row in perf.ROWS],
)
def test_both_sides_compute_the_same(row, monkeypatch):
    for module in [each for name, each in sys.modules.items() if name.startswith("perf.")]:
        for name in SMALL.keys() & vars(module).keys():
            monkeypatch.setattr(module, name, SMALL[name])
    found = []
    for side in (row.ours, row.baseline):
        try:
            found += [side()[0]()] if side else []
        except ModuleNotFoundError as error:
            if error.name.partition(".")[0] in ("perf", "rmpc_bench"):
                raise
            pytest.skip(f"needs {error.name}")
    numbers = [perf.numbers(each) for each in found]
    if len(numbers) == 2 and None not in numbers:
        assert perf.difference(*numbers) <= row.tolerance
