"""docs/suite.md: its tables are those of the configuration, its commands work, and its method is in the table."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from docs.followed_page import follow

from rmpc_bench.config.reader import load
from rmpc_bench.config.tree import plain

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "suite.md"
TEXT = PAGE.read_text(encoding="utf-8")
SET = ROOT / "configs" / "suite" / "suite-1.yaml"


@pytest.fixture(scope="module")
def tree():
    return plain(load(SET))


def table(head):
    """Return the rows of the table whose head begins with a text."""
    lines = TEXT[TEXT.index(f"| {head} |") :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_systems_of_the_page_are_those_of_the_set(tree):
    names = [re.sub(r"\[(.*?)\]\(.*\)", r"\1", row[0]) for row in table("system")]
    rows = tree["sweep"]["zip"]
    assert names == [row["name"] for row in rows] and len(names) >= 12
    for link in re.findall(r"\(\.\./(configs/.*?\.yaml)\)", TEXT):
        assert (ROOT / link).is_file(), link


def test_sizes_and_uncertainty_of_the_page(tree):
    """Oracle: the plants that the configuration builds."""
    from rmpc_bench import load_config

    overrides = ["methods={KF: {estimator: {kind: kalman}}}", "statistics={}", "claims=[]", "figures=[]"]
    for row, cells in zip(tree["sweep"]["zip"], table("system"), strict=True):
        plant = load_config(SET.parent / row["plant.from"], overrides=overrides).experiment.plant
        assert cells[1] == f"{plant.nx}, {plant.ny}"
        law = row.get("plant.uncertainty", {"per": plant.uncertainty.per})
        if plant.system.over_time.H_A.any():
            assert ("white" in cells[2]) == (law["per"] == "step"), cells


def test_worlds_and_methods_of_the_page(tree):
    assert [row[0] for row in table("world")] == [*tree["sweep"]["grid"]["noise"]]
    assert [row[0] for row in table("method")] == [*tree["methods"]]
    assert len(tree["methods"]) >= 8
    untuned = [name for name, method in tree["methods"].items() if "tune" not in method]
    assert untuned == ["KF"] == [row[0] for row in table("method") if row[2] == "none"]
    n_points = len(tree["sweep"]["zip"]) * len(tree["sweep"]["grid"]["noise"])
    assert f"{tree['runs']} runs" in TEXT and f"{n_points} points" in TEXT and f"{tree['time']['steps']} steps" in TEXT
    assert f"tries {tree['tune']['budget']} values" in TEXT and f"on {tree['tune']['runs']} runs" in TEXT


def test_columns_of_the_page(tree):
    """Those of the table of ranks, in its order."""
    heads = [row[0] for row in table("column")]
    assert heads[:3] == ["rank", "n/n_failed", f"ratio to {tree['statistics']['baseline']}"]


@pytest.mark.slow
def test_the_commands_of_the_page(tmp_path):
    """A file and a command: the new method has a rank."""
    planned, added = follow(PAGE, tmp_path)
    assert planned.code == 0 and "56" in planned.out, planned.out + planned.err
    assert added.code == 0, added.out + added.err
    assert "mine" in added.out


def kept(name):
    """A table of the kept results of the set."""
    return pd.read_csv(ROOT / "results" / "suite" / "suite-1" / name)


def test_the_table_of_the_readme_is_the_kept_one():
    """Rank, ratio, ratios of the noise worlds and counts of systems, in the order of the ranks."""
    rows = re.findall(r"^\| .+ \| \d+ to \d+ \|.*$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    shown = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    ranks = kept("ranks.csv")
    whole = ranks[ranks.axis.isna()]
    assert [row[1] for row in shown] == [f"{each.rank_low:.0f} to {each.rank_high:.0f}" for each in whole.itertuples()]
    names = ("as modelled", "scaled", "heavy-tailed", "biased")
    worlds = [ranks[ranks.value == name].set_index("method") for name in names]
    for row, each in zip(shown, whole.itertuples(), strict=True):
        numbers = [float(text) for text in re.findall(r"[\d.]+", row[2])]
        assert numbers == [round(value, 3) for value in (each.ratio, each.ratio_low, each.ratio_high)][: len(numbers)]
        if each.method == "KF-R":
            assert row[2:] == ["1"] * 5 + ["-"]
            continue
        for cell, world in zip(row[3:7], worlds, strict=True):
            one = world.loc[each.method]
            assert float(cell.rstrip(" ?")) == float(f"{one.ratio:.3g}"), (each.method, cell)
            assert cell.endswith("?") == (one.ratio_low < 1 < one.ratio_high)
        assert row[7] == f"{each.better:.0f}/{each.worse:.0f}"


def test_the_share_of_one_system_is_the_stated_one():
    """The geometric means without simon-motor, from the kept comparisons; and the ends of ranges."""
    compared = kept("comparisons.csv")
    others = compared[compared["name"] != "simon-motor"]
    logs = np.log1p(others.geometric_pct / 100).groupby(others.method).mean()
    stated = re.search(r"Without it the ratios to KF-R are (.+?)\. These", TEXT.replace("\n", " "))
    found = {method: float(number) for number, method in re.findall(r"([\d.]+) \(([\w-]+)\)", stated[1])}
    assert found == {method: round(float(np.exp(value)), 2) for method, value in logs.items()}
    ends = kept("tuning.csv").end_of_range
    assert f"{int(ends.sum())} of {len(ends)}" in TEXT
