"""Adjusted comparisons from the configuration to tables: the numbers of the guide, what they rest on, and words."""

import csv
import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from comparison_tables import drawn, extent_of, table
from scipy import stats
from small_experiment import cli, write
from uncertain_experiment import METHODS, PLANT, write_estimation

import rmpc_bench
from rmpc_bench.analysis.comparison import ADJUSTED, averages_of, comparisons, levels
from rmpc_bench.analysis.intervals import student
from rmpc_bench.analysis.levels import held_level
from rmpc_bench.analysis.pairs import pairs_of
from rmpc_bench.analysis.resolution import half_widths
from rmpc_bench.analysis.result_rows import result_table
from rmpc_bench.analysis.statistics import summary
from rmpc_bench.analysis.superiority import runs_for_direction
from rmpc_bench.figures.rows import Rows
from rmpc_bench.report.run_notes import adjustment_text
from rmpc_bench.types import ConfigError
from rmpc_bench.types.metric import AdjustKeys

README = """
version: 1
name: servo
seed: 1
runs: 60
time: {step: 0.1, duration: 20}
uncertainty: {eps: +-20%, eps_load: +-80%}
plant: {kind: servo, perturb: {K_t: 1 + eps, J_l: 1 + eps_load}}
model: {kind: servo-linear, noise: {process: 1, measurement: 1}}
reference: {kind: constant, value: pi/2}
controller: {kind: mpc, Hp: 10, Hu: 3, Q: 0.1, R: 0.1, scale: {u: 440, y: 2*pi}, limits: {u: [-220, 220]}}
methods:
  S-MPC: {estimator: {kind: kalman}}
  R-MPC: {estimator: {kind: robust-kalman, c: 0.1}}
metrics: [mse, settling_time]
figures: [rows]
"""
UNIT = {"dist": "uniform", "low": -1, "high": 1}


@pytest.fixture(scope="module")
def readme(tmp_path_factory):
    """The experiment at the head of the README."""
    place = tmp_path_factory.mktemp("servo")
    (place / "servo.yaml").write_text(README, encoding="utf-8")
    rmpc_bench.run(rmpc_bench.load_config(place / "servo.yaml"), directory=place / "out", jobs=1)
    return place


def row_of(trials, method, metric="mse"):
    """Return a row of comparisons.csv."""
    return next(row for row in comparisons(trials) if (row["method"], row["metric"]) == (method, metric))


def words(trials):
    """What screen and page say of the adjustment."""
    return adjustment_text([result_table(trials, summary(trials), comparisons(trials), trials.primary_info)])


def test_numbers_of_the_readme(readme):
    """-9.836 % with Student's interval of V, whose upper end the skewness of V moves; and the ratio of the means."""
    trials = rmpc_bench.load_results(readme / "out").trials
    row = row_of(trials, "R-MPC")
    assert row["change_pct"] == row["geometric_adjusted_pct"] == pytest.approx(-9.836, abs=5e-4)
    V = averages_of(trials, pairs_of(trials, "R-MPC", trials.primary_info))["geometric"]
    reach = stats.t.ppf(0.975, 54) * stats.sem(V.values)
    ends = 100 * np.expm1([V.values.mean() - reach, V.values.mean() + reach])
    assert ends == pytest.approx([-10.225, -9.446], abs=5e-4)
    assert row["ci_low"] == pytest.approx(-10.225, abs=5e-4) and -9.446 < row["ci_high"] < -9.4
    ratio = [row[f"mean_adjusted_{end}"] for end in ("pct", "low", "high")]
    # The page writes -10.459; the value is -10.4586.
    assert ratio == pytest.approx([-10.459, -10.773, -10.143], abs=6e-4)
    assert (row["rests_on"], row["adjusted_form"], row["adjusted_for"]) == ("adjusted", "quadratic", "eps eps_load")
    assert row["width_ratio"] == pytest.approx(4.7, abs=0.02)
    plain = row_of(replace(trials, adjust="none"), "R-MPC")
    assert [plain[name] for name in ("change_pct", "ci_low")] == [row["geometric_pct"], row["geometric_low"]]
    assert row["runs_for_equivalence"] < plain["runs_for_equivalence"] / 10
    # An event that may not occur has no average.
    assert row_of(trials, "R-MPC", "settling_time")["rests_on"] == "counts"


def test_screen_page_and_files_of_the_readme(readme):
    """The second line of the note, the plain change in the last columns, and the record with the laws."""
    shown = cli("report", str(readme / "out")).stdout.splitlines()
    assert " adjusted for eps, eps_load (quadratic): 4.7 times narrower than plain" in shown
    assert max(map(len, shown[:-3])) <= 80
    page = (readme / "out/tables/summary.md").read_text(encoding="utf-8")
    assert "| change, not adjusted |" in page and "Adjusted for eps, eps" in page
    head = (readme / "out/comparisons.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert head[-len(ADJUSTED) :] == ADJUSTED and head[-len(ADJUSTED) - 1] == "look"
    note = (readme / "out/tables/mse.note.tex").read_text(encoding="utf-8")
    assert r"adjusted for eps, eps\_load." in note
    results = rmpc_bench.load_results(readme / "out")
    assert "ratios, adjusted for eps, eps_load, 60 paired runs" in rmpc_bench.compare(results).sentences[0]
    both = rmpc_bench.summarise(results).to_latex(columns=["change", "plain"])
    assert "[-11.7, -7.9]" in both and "[-10.2, -9.4]" in both


def test_figure_of_rows_has_both_intervals(readme):
    """The plain one is thin and pale, behind the adjusted one."""
    trials = rmpc_bench.load_results(readme / "out").trials
    figure = Rows()
    lines = [line for axes in figure.draw(trials).axes[1:] for line in axes.lines if line.get_gid() == "method-R-MPC"]
    wide, narrow = lines[0], lines[1]
    assert wide.get_linewidth() < narrow.get_linewidth() and wide.get_alpha() < 1 and narrow.get_alpha() is None
    assert np.ptp(wide.get_xdata()) > 4 * np.ptp(narrow.get_xdata())
    assert wide.get_zorder() < narrow.get_zorder()
    assert "thin: intervals without the adjustment" in figure.caption(trials)
    assert "thin" not in figure.caption(replace(trials, adjust="none"))


def test_without_an_adjustment_the_files_are_those_of_before(readme, tmp_path):
    """`adjust: none`: no column, no word, no hash of it; changing it computes nothing again."""
    shutil.copytree(readme / "out", tmp_path / "out")
    shown = cli("run", str(readme / "servo.yaml"), "-o", str(tmp_path / "out"), "-s", "statistics.adjust=none")
    assert "adjusted" not in shown.stdout and shown.exit_code == 0
    assert "rests_on" not in (tmp_path / "out/comparisons.csv").read_text(encoding="utf-8")
    pages = [tmp_path / "out/tables/summary.md", tmp_path / "out/tables/mse.note.tex"]
    assert not any("djusted" in each.read_text(encoding="utf-8") for each in pages)
    one, other = (json.loads((each / "out/manifest.json").read_text()) for each in (readme, tmp_path))
    assert one["experiment"] == other["experiment"]
    assert "adjust" not in (readme / "out/config.resolved.yaml").read_text(encoding="utf-8")
    assert "adjust: none" in (tmp_path / "out/config.resolved.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("value", "path", "message"),
    [
        ("[epss]", "statistics.adjust.0", "'epss' is not an uncertain quantity; did you mean 'eps'?"),
        ("{for: [eps, nothing]}", "statistics.adjust.for.1", "'nothing' is not an uncertain quantity; known: eps"),
        ("[]", "statistics.adjust", "must name at least one quantity"),
        ("[eps, eps]", "statistics.adjust.1", "names 'eps' twice"),
        ("{degree: 3}", "statistics.adjust.degree", "must be 1, 2 or 4"),
        ("sometimes", "statistics.adjust", "'auto'"),
    ],
)
def test_what_is_refused(tmp_path, value, path, message):
    """With the key and the nearest choice."""
    with pytest.raises(ConfigError) as caught:
        rmpc_bench.load_config(write(tmp_path, statistics=f"{{adjust: {value}}}"))
    (problem,) = caught.value.problems
    assert problem.path == path and message in problem.message


def test_laws_that_cannot_be_adjusted_for_are_refused(tmp_path):
    """A group, and a law without polynomials; a wide normal law is taken when it is asked for."""
    laws = "{eps: +-20%, both: {of: [p, q], dist: normal, mean: [0, 0], cov: [[1, 0], [0, 1]]}, "
    laws += "t: {dist: triangular, low: 0, mode: 1, high: 2}, wide: {dist: normal, std: 0.1}}"
    names = "[eps, wide, p, t]"
    with pytest.raises(ConfigError) as caught:
        rmpc_bench.load_config(write(tmp_path, uncertainty=laws, statistics=f"{{adjust: {names}}}"))
    assert [each.message for each in caught.value.problems] == [
        "p has no independent law that is known",
        "t has a triangular law, for which there are no polynomials",
    ]


def test_laws_of_the_record(tmp_path):
    """The scale is applied, at every point of a sweep; entries of F that are drawn once per run have a law, too."""
    path = write(tmp_path, uncertainty="{eps: +-20%, scale: 0.5}", sweep="{grid: {uncertainty.scale: [0.5, 0]}}")
    results = rmpc_bench.run(rmpc_bench.load_config(path), directory=tmp_path / "a", jobs=1)
    assert [point.laws["eps"] for point in results.trials.points] == [
        {"dist": "uniform", "low": -0.1, "high": 0.1},
        {"dist": "uniform", "low": 0.0, "high": 0.0},
    ]
    assert "no uncertain quantity" in results.trials.points[1].adjustment.reason
    for law, dist in (("uniform", "uniform"), ("extremes", "choice")):
        plant = PLANT.replace("law: uniform, low: -1, high: 1", f"law: {law}, per: run, low: -1, high: 0.5")
        path = write_estimation(
            tmp_path,
            plant=plant,
            runs=40,
            methods=METHODS,
        )
        found = rmpc_bench.run(rmpc_bench.load_config(path), directory=tmp_path / law, jobs=1).trials
        assert found.laws["F_x.0"]["dist"] == dist and [*found.laws] == [*found.quantities][1:]
        assert [each.name for each in found.adjustment.quantities] == ["F_x.0"]


def test_levels_rest_on_adjusted_values(make_trials):
    """The simultaneous level is that of V of all methods, also over the points of a sweep."""
    one = drawn(make_trials, 120)
    u = np.stack([one.quantities["eps"], one.quantities["eta"]], axis=1)
    b = np.ones(120)
    columns = {name: b * np.exp(s * u[:, 0] + t * u[:, 1] ** 2) for name, s, t in (("A", 1, 0.1), ("C", 0.5, 0.3))}
    rng = np.random.default_rng(3)
    noisy = {name: each * np.exp(0.1 * rng.standard_normal(120)) for name, each in columns.items()}
    trials = replace(one, **_columns({"B": b, **noisy}))
    V = [averages_of(trials, pairs_of(trials, name, trials.primary_info))["geometric"].values for name in ("A", "C")]
    assert levels(trials).held == held_level(np.stack(V, axis=1), 0.95, trials.seed)
    assert levels(replace(trials, adjust="none")).held != levels(trials).held
    row = row_of(trials, "A", "m")
    inconclusive = row_of(replace(trials, margins={"m": 0.5}), "A", "m")
    assert inconclusive["runs_for_direction"] is None and row["rests_on"] == "adjusted"


def _columns(values):
    made = table(values)
    return {"columns": made.columns, "methods": made.methods, "metrics": made.metrics, "baseline": "B"}


def test_runs_needed_and_widths_rest_on_adjusted_values(make_trials):
    """The numbers of runs follow from sd(V), the half width from its interval."""
    rng = np.random.default_rng(5)
    one = drawn(make_trials, 60)
    u = one.quantities["eps"]
    trials = replace(one, **_columns({"B": np.ones(60), "A": np.exp(0.5 * u + 0.05 * rng.standard_normal(60))}))
    row = row_of(trials, "A", "m")
    V = averages_of(trials, pairs_of(trials, "A", trials.primary_info))["geometric"]
    assert row["verdict"] == "inconclusive"
    needed = runs_for_direction(float(V.values.mean()), float(V.values.std(ddof=1)), 0.95)
    assert row["runs_for_direction"] in (needed, None) and needed > 0
    [width] = half_widths(trials)
    low, high = V.interval("geometric", 0.95, trials.seed)
    assert width.value == pytest.approx(math.expm1((high - low) / 2), rel=1e-9)
    assert width.value < half_widths(replace(trials, adjust="none"))[0].value / 3


def test_a_signed_metric(make_trials):
    """Differences in the unit of the metric, with their own columns; the plain ones stay beside them."""
    rng = np.random.default_rng(1)
    one = drawn(make_trials, 60)
    values = {"B": rng.normal(0, 0.1, 60), "A": -1 + 2 * one.quantities["eps"] + rng.normal(0, 0.1, 60)}
    trials = replace(one, **_columns(values))
    row = row_of(trials, "A", "m")
    assert row["average"] == "difference" and row["rests_on"] == "adjusted"
    plain, adjusted = (
        [row[f"{stem}{end}"] for end in ("", "_low", "_high")] for stem in ("difference", "difference_adjusted")
    )
    assert plain == pytest.approx([values["A"].mean() - values["B"].mean(), *student(values["A"] - values["B"], 0.95)])
    assert adjusted[2] - adjusted[1] < (plain[2] - plain[1]) / 3
    assert result_table(trials, summary(trials), comparisons(trials), trials.primary_info).rows[1].change == tuple(
        adjusted
    )
    assert half_widths(trials)[0].value < half_widths(replace(trials, adjust="none"))[0].value / 3


def test_words(make_trials):
    """What it gains, what is left out, or why there is none."""
    many = drawn(make_trials, 200)
    assert words(many).startswith("adjusted for eps, eta (quadratic): ") and words(many).endswith("narrower than plain")
    assert words(replace(many, adjust="none")) == ""
    assert words(drawn(make_trials, 15, laws={"eps": UNIT})) == "not adjusted: 15 runs, 20 are needed for 1 quantity"
    wide = {"eps": UNIT, "eta": {"dist": "normal", "std": 1.0}}
    assert words(drawn(make_trials, 60, laws=wide)).endswith("; eta left out: its normal law is too wide")
    asked = words(drawn(make_trials, 60, laws=wide, adjust=["eta"]))
    assert asked.endswith("the normal law of eta is wide: intervals of few runs are too short")
    assert words(drawn(make_trials, 60, laws={})) == "not adjusted: no uncertain quantity with a known law"
    assert words(replace(many, quantities={"run": many.runs}, laws={})) == ""
    noise = np.random.default_rng(2).normal(size=60)
    only = drawn(make_trials, 60, values=lambda u: {"mse": {"A": np.exp(0.1 * noise), "B": np.ones(60)}})
    assert "gains nothing (" in words(only) or "the draws explain little" in words(only)
    exact = drawn(make_trials, 60, values=lambda u: {"mse": {"A": np.exp(0.3 + u[:, 0]), "B": np.ones(60)}})
    assert words(exact).endswith("(quadratic): the draws explain all differences")
    several = drawn(
        make_trials,
        60,
        values=lambda u: {"mse": {"B": np.exp(0.01 * noise), "A": np.exp(u[:, 0] / 9), "C": np.exp(u[:, 1])}},
    )
    assert "(quadratic): A " in words(replace(several, baseline="B")) and "x  C " in words(
        replace(several, baseline="B")
    )


def test_counts_come_first(make_trials):
    """Fewer than 20 untied pairs, or most pairs equal: today's interval and verdict."""
    rare = drawn(make_trials, 60, values=lambda u: {"mse": {"A": np.where(u[:, 0] > 0.8, 2.0, 1.0), "B": np.ones(60)}})
    row, plain = row_of(rare, "A"), row_of(replace(rare, adjust="none"), "A")
    assert row["rests_on"] == "counts" and row["adjusted_form"] == ""
    assert {**row, "rests_on": ""} == pytest.approx(plain, nan_ok=True)
    nothing = drawn(make_trials, 60, values=lambda u: {"mse": {"A": np.ones(60), "B": np.ones(60)}})
    assert row_of(nothing, "A")["verdict"] == row_of(replace(nothing, adjust="none"), "A")["verdict"]


def test_failed_runs(make_trials):
    """V is over all drawn runs; a method of which every run failed has no change, and nothing breaks."""
    base = drawn(make_trials, 200)
    u = base.quantities["eps"]
    a = np.where(u > 0.6, np.nan, np.exp(0.3 * u))
    trials = replace(base, **_columns({"B": np.ones(200), "A": a}))
    row = row_of(trials, "A", "m")
    assert row["verdict"] == "fails-more" and row["rests_on"] == "adjusted"
    # The truth is the mean of 0.3 u for u below 0.6.
    assert row["geometric_adjusted_low"] <= 100 * np.expm1(0.3 * -0.2) <= row["geometric_adjusted_high"]
    gone = replace(base, **_columns({"B": np.ones(200), "A": np.full(200, np.nan)}))
    assert row_of(gone, "A", "m")["rests_on"] == "counts"
    few = replace(base, **_columns({"B": np.ones(200), "A": np.where(u > -0.1, np.nan, np.exp(0.3 * u))}))
    assert row_of(few, "A", "m")["rests_on"] == "plain" and "most runs failed" in words(few)


def test_a_rule_about_widths_stops_earlier(tmp_path):
    """`stop: {resolve: ..}` looks at adjusted intervals, for which it reads the draws."""
    ends = []
    for adjust in ("auto", "none"):
        path = write(
            tmp_path,
            file=f"{adjust}.yaml",
            runs=20,
            noise="none",
            uncertainty="{eps: +-80%}",
            time="{step: 0.1, steps: 80}",
            statistics=f"{{adjust: {adjust}}}",
            stop="{resolve: 0.001%, max_runs: 60, every: 10}",
        )
        results = rmpc_bench.run(rmpc_bench.load_config(path), directory=tmp_path / adjust, jobs=1)
        ends.append(len(results.trials.runs))
    assert ends == [40, 60]


def test_another_adjustment_is_another_look(tmp_path):
    """After a verdict the level is that of a second look; the same setting keeps the number of its look."""
    found = []
    for place, adjust in (("one", "auto"), ("one", "none"), ("one", "auto"), ("two", "none")):
        statistics = f"{{adjust: {adjust}}}"
        keys = {"noise": "none", "uncertainty": "{eps: +-80%}", "time": "{step: 0.1, steps: 80}"}
        path = write(tmp_path, runs=20, statistics=statistics, **keys)
        assert cli("run", path, "-o", tmp_path / place, "-j", 1).exit_code == 0
        row = next(csv.DictReader((tmp_path / place / "comparisons.csv").read_text().splitlines()))
        found.append((int(row["look"]), float(row["ci_level"])))
    assert found == [(1, 0.95), (2, pytest.approx(0.991667)), (1, 0.95), (1, 0.95)]


def test_degree_is_an_upper_limit(make_trials):
    """`{for: [eps], degree: 1}` of the configuration reaches the tables."""
    trials = drawn(make_trials, 200, adjust=AdjustKeys(["eps"], 1))
    row = row_of(trials, "A")
    assert (row["adjusted_form"], row["adjusted_for"]) == ("linear", "eps")
    assert extent_of(trials).planned == 200


@pytest.mark.slow
def test_numbers_of_fig_7(tmp_path):
    """R-MPC1 alone at 95 %, 200 runs, geometric mean: -10.120 [-10.588, -9.651]; without the adjustment -10.91."""
    config = rmpc_bench.load_config("configs/zenere2018/fig7.yaml")
    trials = rmpc_bench.run(config, directory=tmp_path, jobs=1).trials
    found = averages_of(trials, pairs_of(trials, "R-MPC1", trials.primary_info))["geometric"]
    ends = 100 * np.expm1([found.values.mean(), *found.interval("geometric", 0.95, trials.seed)])
    assert found.basis.form == "quadratic" and ends == pytest.approx([-10.120, -10.588, -9.651], abs=6e-4)
    assert row_of(trials, "R-MPC1")["geometric_pct"] == pytest.approx(-10.91, abs=5e-3)
