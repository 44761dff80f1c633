"""The table of ranks: numbers against plain loops over the trials, words, files and the page."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from claim_tables import make_trials as make_trials
from data_frames import arrays
from small_experiment import cli, write

from rmpc_bench import load_config
from rmpc_bench.analysis.ranks import Ratio
from rmpc_bench.analysis.runs import RunNotes
from rmpc_bench.report.page.rows import ranked_rows
from rmpc_bench.report.ranks_table import LIMITATIONS, part_columns, ranks_table
from rmpc_bench.report.screen_tables import rank_lines
from rmpc_bench.types import ConfigError
from rmpc_bench.types.tuning import Tuning, TuningProtocol, TuningSearch

SYSTEMS = [f"s{number}" for number in range(8)]
WORLDS = ["modelled", "biased"]
SHIFTS = {"good": -0.5, "same": 0.0, "KF": 0.0, "bad": 0.7}


@pytest.fixture
def sweep(make_trials):
    """Return a function that makes a sweep over systems and worlds; ``lost`` runs of the bad method fail."""

    def make(lost=0, ranks=True):
        rng, tables = np.random.default_rng(3), []
        for system, world in product(SYSTEMS, WORLDS):
            common = rng.normal(size=30)
            values = {
                name: np.exp(common + shift * (1 + (world == "biased")) + 0.05 * rng.normal(size=30)).tolist()
                for name, shift in SHIFTS.items()
            }
            values["bad"][:lost] = [None] * lost
            point = {"name": system, "noise": world}
            table = replace(make_trials({"mse": values}), point=point, title=f"{system}, {world}", baseline="KF")
            tables.append(replace(table, ranks=ranks, axes=(("name",), ("noise",))))
        frame = pd.concat([table.frame for table in tables], ignore_index=True)
        return replace(
            tables[0], columns=arrays(frame), paths=("name", "noise"), points=tuple(tables), point={}, title=""
        )

    return make


def test_numbers(sweep):
    """Oracle: plain loops over the values of the points."""
    trials = sweep()
    table = ranks_table(trials).frame.set_index(["axis", "value", "method"]).sort_index()

    def ratio(method, **where):
        points = [each for each in trials.points if all(each.point[key] == value for key, value in where.items())]
        logs = [np.log(each.column("mse", method) / each.column("mse", "KF")).mean() for each in points]
        return np.exp(np.mean(logs))

    for method in ("good", "same", "bad"):
        # ranks.csv has six digits.
        np.testing.assert_allclose(table.loc["", "", method]["ratio"], ratio(method), rtol=1e-5)
        for world in WORLDS:
            found = table.loc["noise", world, method]
            np.testing.assert_allclose(found["ratio"], ratio(method, noise=world), rtol=1e-5)
            assert found["ratio_low"] <= found["ratio"] <= found["ratio_high"] and found["n_points"] == len(SYSTEMS)
        parts = {system: ratio(method, name=system) for system in SYSTEMS}
        whole = table.loc["", "", method]
        assert whole["smallest_at"] == min(parts, key=parts.get) and whole["largest_at"] == max(parts, key=parts.get)
        np.testing.assert_allclose(
            [whole["smallest"], whole["largest"]], [*sorted(parts.values())][:: len(parts) - 1], rtol=1e-5
        )
    rows = table.loc["", ""].loc[["good", "same", "KF", "bad"]]
    assert rows[["rank_low", "rank_high"]].to_numpy().tolist() == [[1, 1], [2, 3], [2, 3], [4, 4]]
    assert rows[["better", "worse"]].loc[["good", "bad"]].to_numpy().tolist() == [[8, 0], [0, 8]]
    assert (rows["n"] == 30 * 16).all() and not rows["n_failed"].any()


def test_a_rank_is_never_a_number_alone_and_claims_nothing_beyond_its_points(sweep):
    """In the table, on the screen and in sentences; one point needs no such words."""
    table = ranks_table(sweep())
    assert table.columns["rank"] == ["1 to 1", "2 to 3", "2 to 3", "4 to 4"]
    assert table.sentences[0].startswith("good: rank 1 to 1 of 4, ratio to KF 0.4")
    head, first, *_ = rank_lines(table.found, table.trials, 80)
    assert head.split() == ["method", "ratio", "to", "KF", "rank"] and first.split()[0] == "good"
    assert first.split()[-3:] == ["1", "to", "1"]
    assert [*table.columns][3:6] == ["ratio to KF", "modelled", "biased"]
    assert "| method" in table.to_markdown() and str(table) == "\n".join(table.sentences)
    table = ranks_table(sweep())
    assert all(text.endswith(" at these 16 points.") for text in table.sentences) and len(table.sentences) == 4
    assert any(text.startswith("rank, ratio: of these points") for text in table.legend)
    single = sweep()
    alone = ranks_table(replace(single.points[0], ranks=True, axes=single.axes))
    assert alone.columns and not any("points" in text for text in (*alone.sentences, *alone.legend))


def test_the_page_has_a_row_per_method_with_its_rank(sweep):
    """The ratio is drawn, the rank is the verdict, and parts of the sweep are columns on demand."""
    trials = sweep()
    rows = ranked_rows(ranks_table(trials).found, trials)
    assert [row.method for row in rows.rows] == ["good", "same", "KF", "bad"]
    assert [row.cells[2].text for row in rows.rows] == ["1", "2 to 3", "2 to 3", "4"]
    good, same, base, bad = rows.rows
    assert [row.cells[0].css for row in (good, same, bad)] == ["s0 better", "s0 inconclusive", "s0 worse"]
    assert good.cells[1].text.startswith("\u2212") and base.cells[1].text == "" and base.css == "base"
    assert [head.text for head in rows.heads][3:5] == ["modelled", "biased"] and good.cells[3].text == "\u00d70.609"


def test_failures_stand_first_and_the_rest_is_said(sweep):
    """The worst method keeps its place, and the numbers of runs behind the ratios are named."""
    table = ranks_table(sweep(lost=12))
    assert table.columns["n/n_failed"][-1] == f"{30 * 16}/{12 * 16}"
    assert f"bad {18 * 16} of {30 * 16} runs at 16 points" in table.legend[-1]
    assert table.sentences[-1].startswith(f"bad: {12 * 16} of {30 * 16} runs failed; rank 4 to 4 of 4")
    assert ranks_table(sweep()).rest == ""


def test_the_cost_of_tuning_times_that_are_not_known_and_sources_of_parameters(sweep):
    """Equal searches count once; a column where methods differ, and the word of a baseline that is not tuned."""
    protocol, trials = TuningProtocol(3, 5, "mse"), sweep()
    rest = np.zeros((3, 0)), ("grid",) * 3, np.ones((3, 5)), None, 0, protocol
    search = TuningSearch("", "good", (), (), *rest, seconds=2.0, key="a")
    searches = search, replace(search, point="again"), replace(search, method="bad", key="b")
    table = ranks_table(trials.with_tuning(Tuning(protocol, searches, {})))
    assert "tuning: 30 trials on other runs, 4 s" in table.legend
    assert not any(text.startswith("time per step") for text in table.legend)
    notes = {"good": RunNotes(100, seconds_per_step=2e-6), "bad": RunNotes(100)}
    table = ranks_table(replace(trials, points=tuple(replace(point, notes=notes) for point in trials.points)))
    assert dict(zip(table.methods, table.columns["time per step"], strict=True))["good"] == "2.0 us"
    assert any(text.startswith("time per step -:") for text in table.legend)
    words = dict.fromkeys(SHIFTS, "tuned (budget 16, 40 runs)")
    table = ranks_table(replace(sweep(), parameters={**words, "KF": "default"}))
    cells = dict(zip(table.methods, table.columns["parameters"], strict=True))
    assert cells == {**dict.fromkeys(SHIFTS, "tuned"), "KF": "default"}
    assert table.legend[-2:] == ["tuned = budget 16, 40 runs", "KF: default, not tuned"]
    alike = ranks_table(replace(sweep(), parameters=words))
    assert "parameters" not in alike.columns and alike.legend[-1] == "parameters: tuned (budget 16, 40 runs)"


def test_only_where_it_is_asked_for(sweep, make_trials):
    """Without the key, without verdicts and for an MSE of 0 there are no columns, no file and no section of a page."""
    table = ranks_table(sweep(ranks=False))
    assert table.columns == {} and table.to_markdown() == "" and table.sentences == ()
    assert not len(table.frame) and table.found is None
    zero = replace(make_trials({"mse": {"A": [1.0, 0.0], "B": [1.0, 2.0]}}), ranks=True)
    for trials in (replace(sweep(), with_verdicts=False), zero):
        assert ranks_table(trials).columns == {}


def test_files_and_page_and_metrics_without_ratios(tmp_path):
    """An experiment without a sweep: ranks.csv, tables/ranks.md, the section of the page with its limitations."""
    out = tmp_path / "out"
    result = cli("run", write(tmp_path, statistics="{ranks: true}"), "-o", out, "-j", 1, "--progress", "none")
    assert result.exit_code == 0 and " ratio to S-MPC" in result.stdout
    assert pd.read_csv(out / "ranks.csv")["rank_low"].min() == 1
    assert (out / "tables" / "ranks.md").read_text().startswith("# ")
    assert "| method | change | rank |" in (out / "report.md").read_text()
    page = (out / "report.html").read_text()
    assert all(text in page for text in LIMITATIONS)
    file = write(tmp_path, statistics="{ranks: true, primary: settling_time}", metrics="[mse, settling_time]")
    with pytest.raises(ConfigError, match=r"statistics.ranks: settling_time may not occur.*statistics.primary"):
        load_config(file)


def test_two_paths_with_the_same_values_keep_their_columns():
    def ratio(axis, value, x):
        return Ratio(axis, value, "A", x, x, x, 1, 1)

    places = [("plant.n", "1"), ("plant.n", "2"), ("noise.m", "1"), ("noise.m", "3")]
    values = [ratio(axis, value, 0.5) for axis, value in places]
    found = SimpleNamespace(rows=[SimpleNamespace(method="A", by_value=values)], n_values=1)
    assert [*part_columns(found, "KF")] == ["n=1", "2", "m=1", "3"]
