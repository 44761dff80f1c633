"""Tables of runs that are not paired: the option, what it refuses, words of screen, page and tables, other verbs."""

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy import stats

import rmpc_bench
from rmpc_bench.cli import main
from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.types import ConfigError


def call(*words, code=0):
    """Return the output of a command that ends with a code."""
    found = CliRunner().invoke(main, [*map(str, words)])
    assert found.exit_code == code, found.output
    return found.output


def frame(n=40, *, methods=("KF", "R"), seed=1):
    """Return a table of methods with draws of their own, of which the second one is better."""
    rng = np.random.default_rng(seed)
    parts = [
        pd.DataFrame(
            {"run": range(n), "method": name, "status": "ok", "mse": factor * np.exp(0.3 * rng.normal(size=n))}
        )
        for name, factor in zip(methods, (1.0, 0.6, 1.1), strict=False)
    ]
    rows = pd.concat(parts, ignore_index=True)
    rows.loc[rows.index.isin([2, n + 3]), ["status", "mse"]] = ["diverged", np.nan]
    return rows


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """A table, its directory of results, and the screen."""
    place = tmp_path_factory.mktemp("unpaired")
    frame(methods=("KF", "R", "S")).to_csv(place / "runs.csv", index=False)
    screen = call("import", place / "runs.csv", "-o", place / "out", "--unpaired")
    return place, screen


def test_screen_page_and_tables_do_not_speak_of_pairs(imported):
    place, screen = imported
    results = rmpc_bench.load_results(place / "out")
    table = rmpc_bench.compare(results)
    texts = {
        "screen": screen,
        "page": (place / "out" / "report.html").read_text(encoding="utf-8"),
        "comparison": str(table),
        **{file.name: file.read_text(encoding="utf-8") for file in (place / "out" / "tables").iterdir()},
    }
    for name, text in texts.items():
        for words in (
            "same draws",
            "paired run",
            "is paired with",
            "won/lost",
            "won ",
            "superiority",
            "nothing in common",
        ):
            assert words not in text, (name, words)
    assert "runs are not paired" in screen
    assert "they are not paired" in texts["page"]
    assert "Runs are not paired" in texts["mse.note.tex"]
    basis = "(ratio of the geometric means, 39 and 39 runs, simultaneous 95 % interval; not paired)"
    assert basis in table.sentences[0]
    assert "R is better than KF" in screen


def test_numbers_are_those_of_welch_and_columns_of_pairs_are_empty(imported):
    place, _ = imported
    rows, read = pd.read_csv(place / "runs.csv"), pd.read_csv(place / "out" / "comparisons.csv")
    logs = {name: np.log(each["mse"].dropna()) for name, each in rows.groupby("method")}
    low, high = stats.ttest_ind(logs["R"], logs["KF"], equal_var=False).confidence_interval(0.975)
    row = read.iloc[0]
    assert (row["verdict"], row["ci_level"]) == ("better", 0.975)
    # Six digits are written.
    assert [row["ci_low"], row["ci_high"]] == pytest.approx([100 * np.expm1(low), 100 * np.expm1(high)], rel=1e-4)
    assert read[["won", "lost", "tied", "superiority", "n_pairs", "far_worse_runs"]].isna().all(axis=None)
    assert "rests_on" not in read


def test_other_verbs_take_the_directory(imported, tmp_path):
    place, _ = imported
    frame(methods=("KF", "R"), seed=2).to_csv(tmp_path / "more.csv", index=False)
    call("import", tmp_path / "more.csv", "-o", tmp_path / "more", "--unpaired")
    text = " ".join(call("compare", place / "out", tmp_path / "more", "--of", "R").split())
    assert "geometric means, unpaired: 39 and 39 runs" in text and "Welch" in text
    assert "ties count half" not in text and "seeds" not in text
    assert "B - A [points]" in call("compare", place / "out", tmp_path / "more", code=1)
    frame(methods=("S",), seed=3).to_csv(tmp_path / "s.csv", index=False)
    call("import", tmp_path / "s.csv", "-o", tmp_path / "more", "--add")
    assert rmpc_bench.load_results(tmp_path / "more").trials.unpaired
    call("pack", tmp_path / "more", "-o", tmp_path / "p.zip")
    assert "all equal" in call("verify", tmp_path / "p.zip")
    with pytest.raises(StoreError, match="holds runs in pairs"):
        rmpc_bench.import_runs(frame(), directory=tmp_path / "pairs")
        rmpc_bench.import_runs(frame(methods=("S",)), directory=tmp_path / "pairs", add=True, unpaired=True)


def test_sorted_rows_and_other_draws_are_no_mistake_then(tmp_path):
    rows = frame().dropna().sort_values(["method", "mse"]).drop(columns="run").groupby("method").head(38)
    with pytest.raises(ConfigError, match="look sorted.*or --unpaired"):
        rmpc_bench.import_runs(rows, directory=tmp_path / "a")
    found = rmpc_bench.import_runs(rows, directory=tmp_path / "b", unpaired=True)
    assert found.trials.unpaired and "nothing in common" not in str(rmpc_bench.compare(found))
    rows = frame().assign(eps=np.tile(np.arange(40) / 7, 2))
    rows.loc[50, "eps"] = 9.0
    with pytest.raises(ConfigError, match=r"in run 10: .* same draws \(--unpaired compares them without pairs\)"):
        rmpc_bench.import_runs(rows, directory=tmp_path / "c")
    found = rmpc_bench.import_runs(rows, directory=tmp_path / "d", unpaired=True, metrics=["mse"])
    assert [each.name for each in found.trials.metrics] == ["mse"]


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"uncertainty": {"eps": "+-20%"}}, "uncertainty"),
        ({"statistics": {"adjust": ["eps"]}}, "statistics.adjust"),
        ({"statistics": {"ranks": True}}, "statistics.ranks"),
        ({"statistics": {"lost": 10}}, "statistics.lost"),
        ({"statistics": {"requirements": ["mse < 1"]}}, "statistics.requirements"),
        ({"claims": [{"says": "s", "source": "o", "check": "mean(mse[R]) < mean(mse[KF])"}]}, "claims"),
    ],
)
def test_what_needs_pairs_is_refused(tmp_path, settings, key):
    with pytest.raises(ConfigError, match=f"{key}: needs runs in pairs"):
        rmpc_bench.import_runs(frame(), directory=tmp_path / "o", settings=settings, unpaired=True)
