"""Main effects and interactions of a grid of methods: numbers against plain loops, words, files, screen and page."""

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest
import yaml
from claim_tables import make_trials as make_trials
from scipy import stats
from small_experiment import cli, ran, text, write

import rmpc_bench
from rmpc_bench.analysis.columns import data_frame
from rmpc_bench.analysis.comparison import comparisons, levels
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.report.two_way_table import two_way_content, two_way_lines, two_way_tables

AXES = {"estimator": ["KF", "EKF"], "controller": ["MPC", "PI"]}
RUNS = [(4, 2, 8, 4), (1, 0.25, 4, 4), (2, 2, 2, 1)]
CELLS = ["KF+MPC", "EKF+MPC", "KF+PI", "EKF+PI"]
PAGE = {"rtol": 1e-5}
"""The page of the method has six digits, as two-way.csv has."""


@pytest.fixture
def crossed(make_trials):
    """Return a function that makes Trials of a grid from ``{metric: {method: values}}``."""

    def make(metrics, *, axes=None, baseline="KF+MPC", primary="", **keys):
        made = make_trials(metrics, **keys)
        return replace(made, two_way=axes or AXES, baseline=baseline, primary=primary or made.metrics[0].name)

    return make


def columns(rows=RUNS, names=CELLS):
    """Return method -> its values in all runs."""
    return dict(zip(names, zip(*rows, strict=True), strict=True))


def effects(trials, metric="mse"):
    """Return entries of both axes -> value and ends of the interval."""
    frame = data_frame(two_way_content(trials))
    frame = frame[(frame["metric"] == metric) & (frame["what"] != "cell")]
    axes = list(trials.two_way)
    return {tuple(row[axes]): row[["value", "low", "high"]].tolist() for _, row in frame.iterrows()}


@pytest.mark.parametrize(
    ("baseline", "other", "interaction"),
    [
        # The interaction of the page is that against KF+PI; against KF+MPC it is the inverse of it.
        ("KF+PI", "MPC", [0.793700526, 0.057197, 11.0139]),
        ("KF+MPC", "PI", [1 / 0.793700526, 1 / 11.0139, 1 / 0.057197]),
    ],
)
def test_the_case_of_the_page(crossed, baseline, other, interaction):
    """Three runs, 95 % single intervals: those of a metric that is not the primary one."""
    trials = crossed({"first": columns(), "mse": columns()}, baseline=baseline)
    found = effects(trials)
    np.testing.assert_allclose(found["EKF", ""], [0.561231024, 0.341405, 0.922599], **PAGE)
    np.testing.assert_allclose(found["EKF", other], interaction, **PAGE)
    cells = data_frame(two_way_content(trials)).query("metric == 'mse' and what == 'cell'")
    means = {tuple(row[["estimator", "controller"]]): row["value"] for _, row in cells.iterrows()}
    # By hand: geometric means of (4, 1, 2), (8, 4, 2), (2, 1/4, 2) and (4, 4, 1).
    expected = {("KF", "MPC"): 2, ("KF", "PI"): 4, ("EKF", "MPC"): 1, ("EKF", "PI"): 16 ** (1 / 3)}
    assert means == pytest.approx(expected, rel=1e-5)


def by_hand(values, first, second, a0, b0, level, *, signed=False):
    """Second implementation: loops over the entries, SciPy's t; `values` has the runs of every cell that is there."""
    logs = {cell: np.asarray(each) if signed else np.log(each) for cell, each in values.items()}

    def interval(of):
        mean, half = of.mean(), stats.t.ppf((1 + level) / 2, len(of) - 1) * of.std(ddof=1) / np.sqrt(len(of))
        ends = [mean, mean - half, mean + half]
        return ends if signed else [*np.exp(ends)]

    found = {}
    for a in first:
        if a != a0 and all((x, b) in logs for x in (a, a0) for b in second):
            found[a, ""] = interval(np.mean([logs[a, b] - logs[a0, b] for b in second], axis=0))
    for b in second:
        if b != b0 and all((a, x) in logs for x in (b, b0) for a in first):
            found["", b] = interval(np.mean([logs[a, b] - logs[a, b0] for a in first], axis=0))
    for a, b in product(first, second):
        corners = [(a, b), (a0, b), (a, b0), (a0, b0)]
        if a != a0 and b != b0 and all(cell in logs for cell in corners):
            one, two, three, four = (logs[cell] for cell in corners)
            found[a, b] = interval(one - two - three + four)
    return found


@pytest.mark.parametrize("direction", ["lower", "higher", "zero", "one"])
@pytest.mark.parametrize("left_out", [(), (("UKF", "PI"),), (("KF", "MPC"), ("UKF", "PI"))])
def test_against_plain_loops(crossed, direction, left_out):
    """Excluded cells, failed runs, a method beside the grid, a baseline in the middle; ratios and differences."""
    first, second, rng = ["KF", "EKF", "UKF"], ["MPC", "PI", "PID"], np.random.default_rng(8)
    common = rng.normal(size=15)
    cells = {
        cell: np.exp(common + 0.3 * rng.normal(size=15)) for cell in product(first, second) if cell not in left_out
    }
    given = {"+".join(cell): values.tolist() for cell, values in cells.items()} | {"oracle": np.exp(common).tolist()}
    given["EKF+PI"][3] = given["UKF+PID"][3] = given["KF+PI"][7] = None
    given["oracle"][1] = None
    trials = crossed(
        {"mse": given, "other": given},
        axes={"estimator": first, "controller": second},
        baseline="EKF+MPC",
        primary="other",
        directions={"mse": direction},
    )
    kept = np.setdiff1d(np.arange(15), [3, 7])
    sizes = {cell: np.maximum(each, 1 / each) if direction == "one" else each for cell, each in cells.items()}
    values = {cell: each[kept] for cell, each in sizes.items()}
    expected = by_hand(values, first, second, "EKF", "MPC", 0.95, signed=direction == "zero")
    found = effects(trials)
    assert found.keys() == expected.keys()
    for cell, numbers in expected.items():
        np.testing.assert_allclose(found[cell], numbers, rtol=1e-5, atol=1e-8)
    assert ("UKF", "") not in found or not left_out
    frame = data_frame(two_way_content(trials))
    assert {*frame["n"]} == {13} and {*frame["n_left_out"]} == {2}
    assert two_way_tables(trials)[0].title.endswith("13 runs, 2 left out")


def test_intervals_of_the_primary_metric_hold_together(crossed):
    """Oracle: their level is that of the comparisons, which has the effects in its family; others have 95 %."""
    rng = np.random.default_rng(3)
    values = {name: np.exp(rng.normal(size=40)).tolist() for name in CELLS}
    trials = crossed({"mse": values, "other": values})
    frame = data_frame(two_way_content(trials)).groupby("metric")["ci_level"].unique()
    held = levels(trials).held
    assert frame["other"].tolist() == [0.95] and frame["mse"].tolist() == pytest.approx([held], rel=1e-5)
    assert {row["ci_level"] for row in comparisons(trials) if row["metric"] == "mse"} == {held}
    # Three comparisons alone have a lower level than together with two main effects and an interaction.
    assert 0.95 < levels(replace(trials, two_way=None)).held < held < 1 - 0.05 / 6 + 1e-12


@pytest.mark.parametrize(
    ("gains", "said"),
    [
        ((-0.12, -0.02), ["the effect of EKF depends on the controller: \u221212.0 % with MPC, \u22122.0 % with PI"]),
        # Both interactions are known to be small, or are not known at all.
        ((-0.12, -0.119), []),
        ((-0.12, None), []),
    ],
)
def test_the_sentence_on_an_interaction(crossed, gains, said):
    """Beyond the relevant change of 1 % in both cases or not: by construction."""
    rng = np.random.default_rng(1)
    kf = {b: np.exp(rng.normal(size=50)) for b in ("MPC", "PI")}
    # The mean of the logarithms is 0, so that the sizes of the gains are exact.
    spread = {b: np.exp(0.02 * stats.zscore(rng.normal(size=50))) for b in kf}
    noise = np.exp(3 * rng.normal(size=50))
    ekf = {b: kf[b] * (noise if gain is None else (1 + gain) * spread[b]) for b, gain in zip(kf, gains, strict=True)}
    values = {f"{a}+{b}": of[b].tolist() for a, of in (("KF", kf), ("EKF", ekf)) for b in kf}
    [table] = two_way_tables(crossed({"mse": values}))
    assert table.sentences == said


def test_signed_differences_have_their_margin_and_unit(crossed):
    """Without a margin of its own any interaction that excludes 0 is relevant; with one only a larger one."""
    noise = stats.zscore(np.random.default_rng(2).normal(size=(4, 30)), axis=1)
    values = {name: (5 + gain + 0.01 * of).tolist() for name, gain, of in zip(CELLS, (0, 1, 0, 3), noise, strict=True)}
    trials = crossed({"bias": values}, directions={"bias": "zero"})
    said = "the effect of EKF depends on the controller: +1.000 with MPC, +3.000 with PI"
    assert two_way_tables(trials)[0].sentences == [said]
    assert not two_way_tables(replace(trials, margins={"bias": 2.5}))[0].sentences


@pytest.mark.parametrize(
    "change",
    [
        {"two_way": None},
        {"two_way": {"estimator": ["KF", "EKF"]}},
        {"two_way": {**AXES, "model": ["A"]}},
        {"two_way": {"estimator": ["KF"], "controller": ["MPC", "PI"]}},
        {"two_way": {"estimator": ["A"], "controller": ["B"]}},
        {"with_verdicts": False},
    ],
)
def test_no_table(crossed, change):
    """Without two axes of at least two entries, and in a smoke run, there is none."""
    trials = replace(crossed({"mse": columns()}), **change)
    assert two_way_tables(trials) == () and not two_way_content(trials)


def test_metrics_without_an_average_have_none(crossed):
    """An event that may not occur, a value of 0 where ratios are compared, and a metric that all runs failed in."""
    zero = columns([*RUNS, (0, 1, 1, 1)])
    trials = crossed({"mse": zero, "settling_time": zero})
    infos = tuple(info._replace(may_not_occur=info.name == "settling_time") for info in trials.metrics)
    assert two_way_tables(replace(trials, metrics=infos)) == ()
    assert two_way_tables(crossed({"mse": columns([(None, 1, 1, 1)] * 3)})) == ()


def test_equal_methods_have_no_effect_and_no_noise(crossed):
    """Rounding errors are not shown as an effect, nor as spread."""
    values = {name: (np.array([0.1, 0.2, 0.7]) * (1 + k * 1e-15)).tolist() for k, name in enumerate(CELLS)}
    found = effects(crossed({"mse": values}))
    assert {tuple(each) for each in found.values()} == {(1.0, 1.0, 1.0)}


def test_the_screen_takes_what_fits(crossed):
    """With interactions, without them, or not at all; what is left out is named with its file."""
    [table] = two_way_tables(crossed({"mse": columns()}))
    wide, narrow = two_way_lines(table, 200), two_way_lines(table, 72)
    assert (
        "2.52 (+26 % [-91, +1648])" in "\n".join(wide) and "(" not in "\n".join(narrow) and "-44 %" in "\n".join(narrow)
    )
    assert wide[:2] == narrow[:2] == ["", "MSE, 3 runs"]
    assert narrow[-1] == " interactions: two-way.csv" and not any("two-way.csv" in line for line in wide)
    assert two_way_lines(table, 30) == ["", "MSE, 3 runs: two-way.csv"]


GRID = (
    "{grid: {estimator: {KF: {kind: kalman}, RF: {kind: robust-kalman, c: 1}, FF: {kind: fading-kalman, alpha: 1.2}}, "
    "controller: {MPC: {Hp: 12}, short: {Hp: 5}}}, exclude: [{estimator: FF, controller: short}]}"
)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return the directory of a run of a small grid."""
    there = tmp_path_factory.mktemp("grid")
    ran(write(there, methods=GRID, runs=8, time="{step: 0.1, steps: 80}"), there / "out")
    return there / "out"


def test_files_screen_and_page(results):
    """Reports read stored results only, also after the configuration is gone."""
    frame = pd.read_csv(results / "two-way.csv")
    assert list(frame) == [
        "metric",
        "what",
        "estimator",
        "controller",
        "value",
        "low",
        "high",
        "ci_level",
        "n",
        "n_left_out",
    ]
    trials = pd.read_csv(results / "trials.csv").pivot(index="run", columns="method", values="input_power")
    gain = np.log(trials["RF+MPC"] / trials["KF+MPC"]) / 2 + np.log(trials["RF+short"] / trials["KF+short"]) / 2
    row = frame[(frame["metric"] == "input_power") & (frame["estimator"] == "RF") & frame["controller"].isna()]
    np.testing.assert_allclose(row["value"], [np.exp(gain.mean())], **PAGE)
    # FF has no method with the short horizon, so that neither has a main effect.
    mains = frame[frame["what"] == "main effect"]
    assert {*mains["estimator"]} == {"RF"} and not (frame["what"] == "interaction")[frame["estimator"] == "FF"].any()
    (results / "config.yaml").unlink()
    (results / "two-way.csv").unlink()
    screen = cli("report", results)
    assert (
        screen.exit_code == 0 and " estimator+controller " in screen.output and " effect of controller" in screen.output
    )
    pd.testing.assert_frame_equal(pd.read_csv(results / "two-way.csv"), frame)
    page, markdown = ((results / f"report.{ending}").read_text(encoding="utf-8") for ending in ("html", "md"))
    assert "Estimator and controller</b>" in page and '<td class="n">' in page and "effect of estimator" in page
    assert "| estimator+controller | MPC | short | effect of estimator |" in markdown


def test_an_archive_has_the_table_and_verifies(results, tmp_path):
    """Its configuration is the resolved one, whose methods are written out."""
    ran(write(tmp_path, methods=GRID, runs=4), tmp_path / "out")
    packed = cli(
        "pack", tmp_path / "out", "-o", tmp_path / "tiny.zip", "--author", "A. Author", "--licence", "CC-BY-4.0"
    )
    assert packed.exit_code == 0, packed.output
    verified = cli("verify", tmp_path / "tiny.zip")
    assert verified.exit_code == 0, verified.output
    config = rmpc_bench.load_config(write(tmp_path, methods=GRID, runs=4))
    again = tmp_path / "again.yaml"
    again.write_text(dump(config.resolved), encoding="utf-8")
    ran(again, tmp_path / "again")
    assert (tmp_path / "again/two-way.csv").read_bytes() == (tmp_path / "out/two-way.csv").read_bytes()


def test_a_mapping_in_python_and_a_sweep(tmp_path):
    """Columns of a sweep come first; every point has its own table."""
    data = yaml.safe_load(text(methods=GRID, sweep="{grid: {methods.KF+MPC.controller.Hp: [12, 14]}}", runs=3))
    results = rmpc_bench.run(data, directory=tmp_path / "out", jobs=1)
    rmpc_bench.publish(results)
    frame = pd.read_csv(tmp_path / "out/two-way.csv")
    assert list(frame)[:2] == ["methods.KF+MPC.controller.Hp", "metric"]
    assert len(two_way_tables(results.trials)) == 4 and [*frame.iloc[:, 0].unique()] == [12, 14]


def test_runs_with_a_failed_method_are_left_out_and_counted(tmp_path):
    """From the file on: some runs with the short horizon leave the range of the state."""
    plant = "{kind: servo-linear, perturb: {J_l: 1 + eps}, diverged: [2.5785, 1e3, 1e3, 1e3]}"
    path = write(tmp_path, methods=GRID, plant=plant, time="{step: 0.1, steps: 40}", execution="{max_failures: 1000}")
    ran(path, tmp_path / "out")
    trials, frame = (pd.read_csv(tmp_path / f"out/{name}.csv") for name in ("trials", "two-way"))
    lost = trials.groupby("run")["status"].agg(lambda words: (words != "ok").any()).sum()
    assert 0 < lost < 6 and {*frame["n_left_out"]} == {lost} and {*frame["n"]} == {6 - lost}
