"""docs/suite.md: its tables are those of the configuration, its commands work, and its method is in the table."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from docs.followed_page import follow
from docs.suite_page import LEFT_OUT, NOT_APPLICABLE, ONE_PLANT, interval, kept, over_systems, row_logs, short, without

from rmpc_bench import load_config
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "suite.md"
TEXT = PAGE.read_text(encoding="utf-8")
SET = ROOT / "configs" / "suite" / "suite-1.yaml"


@pytest.fixture(scope="module")
def tree():
    return plain(load(SET))


def plant_of(row):
    """Build the plant of a row of the set."""
    overrides = ["methods={KF: {estimator: {kind: kalman}}}", "statistics={}", "claims=[]", "figures=[]"]
    return load_config(SET.parent / row["plant.from"], overrides=overrides).experiment.plant


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
    for row, cells in zip(tree["sweep"]["zip"], table("system"), strict=True):
        plant = plant_of(row)
        assert cells[1] == f"{plant.nx}, {plant.ny}"
        law = row.get("plant.uncertainty", {"per": plant.uncertainty.per})
        if plant.system.over_time.H_A.any():
            assert ("white" in cells[2]) == (law["per"] == "step"), cells


def test_worlds_and_methods_of_the_page(tree):
    assert [row[0] for row in table("world")] == [*tree["sweep"]["grid"]["noise"]]
    assert [row[0] for row in table("method | filter")] == [*tree["methods"]]
    assert len(tree["methods"]) >= 8
    untuned = [name for name, method in tree["methods"].items() if "tune" not in method]
    assert untuned == ["KF"] == [row[0] for row in table("method | filter") if row[2] == "none"]
    n_points = len(tree["sweep"]["zip"]) * len(tree["sweep"]["grid"]["noise"])
    assert f"{tree['runs']} runs" in TEXT and f"{n_points} points" in TEXT and f"{tree['time']['steps']} steps" in TEXT
    assert f"tries {tree['tune']['budget']} values" in TEXT and f"on {tree['tune']['runs']} runs" in TEXT


def test_columns_of_the_page(tree):
    """Those of the table of ranks, in its order."""
    heads = [row[0] for row in table("column")]
    assert heads[:3] == ["rank", "n/n_failed", f"ratio to {tree['statistics']['baseline']}"]


@pytest.mark.page("suite")
@pytest.mark.slow
def test_the_commands_of_the_page(tmp_path):
    """A file and a command: the new method has a rank."""
    planned, added = follow(PAGE, tmp_path)
    assert planned.code == 0 and "56" in planned.out, planned.out + planned.err
    assert added.code == 0, added.out + added.err
    assert "mine" in added.out


A1 = {
    "KF-dir": "0.578 [0.23, 1.47] 0.990 0.89 [0.55, 1.46] 1.01 [0.78, 1.31] [0.41, 2.50]",
    "Sayed": "0.931 [0.29, 2.97] 1.090 1.51 [0.55, 4.11] 1.26 [0.89, 1.78] [0.38, 4.19]",
    "fading": "0.957 [0.66, 1.39] 1.011 1.12 [0.77, 1.61] 1.09 [0.79, 1.50] [0.36, 3.28]",
    "WKF": "0.982 [0.49, 1.96] 1.003 1.27 [0.61, 2.63] 1.08 [0.78, 1.51] [0.34, 3.44]",
    "KF-R": "1.000 1 1.000 1 1 1",
    "R-KF": "1.038 [0.62, 1.73] 1.023 1.24 [0.71, 2.18] 1.11 [0.81, 1.53] [0.37, 3.36]",
    "H-inf": "1.315 [0.69, 2.50] 1.023 1.53 [0.68, 3.46] 1.20 [0.90, 1.62] [0.43, 3.34]",
    "KF": "1.553 [0.78, 3.08] 1.023 1.75 [0.72, 4.26] 1.32 [0.97, 1.79] [0.46, 3.82]",
    "huber": "1.721 [0.62, 4.75] 1.012 1.99 [0.53, 7.53] 1.24 [0.90, 1.71] [0.41, 3.80]",
    "student": "2.335 [0.45, 12.2] 1.022 2.91 [0.33, 25.3] 1.24 [0.90, 1.72] [0.41, 3.80]",
}
"""Ratio, over 14 rows, median row, one vote per plant, clipped, next plant: computed by another program, from
suite_1_comparisons.csv, the first numbers of the set.  They stay when the set is computed again."""
WITHOUT = {
    "wkf2018 wang2021 wang2021-fixed": "KF-R 1.00 KF-dir 1.09 fading 1.19 R-KF 1.33 WKF 1.41 H-inf 1.59 KF 1.75 "
    "Sayed 1.80 huber 1.99 student 2.90",
    "simon-motor kothare1996 compleib-ac5 compleib-he2 compleib-mfp": "KF-dir 0.384 Sayed 0.528 WKF 0.653 fading 0.770 "
    "R-KF 0.785 H-inf 0.951 KF-R 1.000 huber 1.124 student 1.143 KF 1.170",
}
"""Rows that are left out -> the ratios, the smallest first, from the same program."""


@pytest.fixture(scope="module")
def first():
    """Noise, row, method and ratio of the first comparisons.csv of the set."""
    return pd.read_csv(Path(__file__).with_name("suite_1_comparisons.csv"))


@pytest.mark.parametrize("method", A1)
def test_intervals_over_systems(first, method):
    row = over_systems(first).loc[method]
    rows = "1" if method == "KF-R" else interval(row, "rows").partition(" ")[2]
    more = " ".join(interval(row, name, with_mean=name != "next") for name in ("plants", "clipped", "next"))
    assert f"{row.ratio:.3f} {rows} {row['median']:.3f} {more}" == A1[method]


@pytest.mark.parametrize("rows", WITHOUT)
def test_ratios_without_some_rows(first, rows):
    found, stated = without(first, rows.split()), WITHOUT[rows].split()
    digits = len(stated[1]) - 2
    assert [word for name, value in found.items() for word in (name, f"{value:.{digits}f}")] == stated


def test_the_place_of_the_baseline_depends_on_single_rows(first):
    places = {rows: [*without(first, rows).index].index("KF-R") + 1 for rows in LEFT_OUT if len(rows) == 1}
    assert places == {("wang2021",): 2, ("wang2021-fixed",): 2, ("wkf2018",): 4, ("simon-motor",): 7}


def test_an_interval_over_systems_contains_its_mean_and_widens(first):
    """Equal ratios have no width, one more plant is less certain than the mean, and clipping acts."""
    found = over_systems(first.assign(geometric_pct=-20.0)).loc["WKF"]
    ends = [f"{name}{end}" for name in ("rows", "plants", "next") for end in ("_low", "", "_high")]
    assert {short(found[end]) for end in ends} == {"0.80"}
    found = over_systems(first)
    assert (found.next_high >= found.clipped_high).all() and (found.next_low <= found.clipped_low).all()
    far = over_systems(first.assign(geometric_pct=900.0)).loc["WKF"]
    assert (round(far.plants, 9), round(far.clipped, 9)) == (10, 4)


def test_sayed_is_the_kalman_filter_where_the_page_says_so(tree):
    """Oracle: the matrices of the plants, C H_A = 0; and the kept means of both filters."""
    systems = {row["name"]: plant_of(row).system.over_time for row in tree["sweep"]["zip"]}
    rows = [name for name, system in systems.items() if not np.any(system.C @ system.H_A)]
    assert {*rows} == {*NOT_APPLICABLE["Sayed"]}
    means = kept("summary.csv").pivot(index=["name", "noise"], columns="method", values="mean")
    assert {*means.index[(means.Sayed == means.KF).to_numpy()].get_level_values("name")} == {*rows}


def test_the_table_says_where_a_filter_has_no_effect():
    rows = {row[0]: row for row in table("method | information")}
    n = len(row_logs(kept()))
    assert int(rows["Sayed"][2]) == n - len(NOT_APPLICABLE["Sayed"]) and rows["KF"][2] == "-"
    assert all(int(row[2]) <= n for name, row in rows.items() if name != "KF")
    assert [name for name, row in rows.items() if row[1] == "direction"] == [*rows][-2:] == ["KF-dir", "Sayed"]


def test_the_sentence_of_the_readme_is_that_of_the_kept_numbers():
    """Largest difference of eight filters and of Sayed, rows won by KF."""
    found = over_systems(kept())
    off, kf = 100 * (found["median"] - 1).abs().drop("KF-R"), found.loc["KF"]
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    most = off.drop("Sayed").max()
    assert f"eight filters differ from KF-R by {most:.1f} % at most, Sayed by {off['Sayed']:.0f} %" in readme
    assert f"({kf.won:.0f} of {kf.n_rows:.0f} rows won)" in readme and kf.won == 0
    assert "2.3 %" in TEXT and off.drop("Sayed").size == 8
    others = found.drop("KF-R")
    for name in ("rows", "plants", "clipped"):
        assert ((others[f"{name}_low"] < 1) & (others[f"{name}_high"] > 1)).all()
    assert found.ratio.idxmin() == "KF-dir" and without(kept(), ONE_PLANT[1:]).index[0] == "KF-R"


def sentences_from_the_tables():
    """Of simon-motor, wang2021-fixed, sayed2001 and of the ends of ranges."""
    means = kept("summary.csv").pivot(index=["noise", "name"], columns="method", values="mean")
    factors = 1 + kept().pivot(index=["noise", "name"], columns="method", values="geometric_pct") / 100
    motor = "{as modelled:.3f}, {scaled:.3f}, {heavy-tailed:.3f} and {biased:.3f} in the four noise worlds"
    yield motor.format(**means.KF.xs("simon-motor", level="name"))
    fixed, here = (means.loc["as modelled", name] for name in ("wang2021-fixed", "sayed2001"))
    yield "errors are {KF-dir:.0f} and {Sayed:.0f}".format(**fixed)
    yield "`KF-R` is {KF-R:,.0f} and that of `KF` {KF:,.0f}".format(**fixed)
    yield "means are {KF-dir:.2f} (`KF-dir`), {Sayed:.2f} (`Sayed`) and {WKF:.2f} (`WKF`)".format(**here / here["KF-R"])
    shown = factors.loc["as modelled", "sayed2001"]
    yield "geometric means are {KF-dir:.2f}, {Sayed:.2f} and {WKF:.2f}".format(**shown)
    logs = np.log(factors.loc["heavy-tailed"])
    yield "`huber` and `student` are {huber:.2f} and {student:.2f}, which".format(**np.exp(logs.mean()))
    for name in ("huber", "student"):
        yield f"row is {np.exp(logs[name].median()):.2f} for both"
        assert abs(logs[name].drop("simon-motor").mean()) < 0.05
    outliers = pd.read_csv(ROOT / "results" / "estimators" / "outliers" / "summary.csv")
    outliers = outliers.query("name == '10 % outliers' and metric == 'estimation_mse'").set_index("method")["mean"]
    yield "{huber:.0f} and {student:.0f} against {KF-R:.0f} with 10 % outliers".format(**outliers)
    ends = kept("tuning.csv").end_of_range
    yield f"{int(ends.sum())} of {len(ends)}"
    logs = row_logs(kept())
    yield f"factors of up to {round(float(np.exp(logs.max().max())), -3):,.0f}"
    for name in ("student", "huber"):
        logs.loc["simon-motor", name] = logs.loc["simon-motor", "KF"]
    yield "would be {student:.2f} and {huber:.2f}, below the {KF:.2f} of `KF`".format(**np.exp(logs.mean()))


def test_numbers_in_the_sentences_of_the_page():
    text = " ".join(TEXT.split())
    assert [sentence for sentence in sentences_from_the_tables() if sentence not in text] == []


def test_systems_that_are_not_quadratically_stable():
    """Those of the page are those of which `describe` says it; Sayed's theory asks for it."""
    from small_experiment import cli

    (paragraph,) = (part for part in TEXT.split("\n\n") if "quadratically stable" in part)
    stated = {*re.findall(r"(?:benchmarks/|`)([a-z]+[\w-]*\d?)(?:\.yaml)?`", paragraph)}
    for row in plain(load(SET))["sweep"]["zip"]:
        if "plant.uncertainty" not in row:
            done = cli("describe", SET.parent / row["plant.from"])
            assert ("quadratically stable: no" in done.output) == (row["name"] in stated), row["name"]
