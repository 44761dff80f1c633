"""Runs made elsewhere: the same trials imported and native give the same tables, in every form of a table."""

import gzip
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import rmpc_bench
from rmpc_bench.importing.directory import prepare_import
from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.types import ConfigError

EXACT_NUMBERS = {"float_precision": "round_trip"} if pd.__version__ < "3.1" else {}
LAWS = {"eps_min": "+-10%", "eps_max": "+-20%", "eps_jl": "+-80%"}


@pytest.fixture(scope="module")
def native(tmp_path_factory):
    """A published directory of simulated runs, some of them failed, and its table of runs."""
    place = tmp_path_factory.mktemp("native") / "quickstart"
    config = rmpc_bench.load_config("configs/quickstart.yaml", runs=24, overrides=["plant.diverged=38"])
    rmpc_bench.publish(rmpc_bench.run(config, directory=place, jobs=1))
    rows = pd.read_csv(place / "trials.csv", **EXACT_NUMBERS)
    drawn = pd.read_csv(place / "uncertainty.csv", **EXACT_NUMBERS)
    return place, rows.merge(drawn, on="run")


def settings_of(place):
    """Return the settings with which a table of the native trials is the native experiment."""
    experiment = rmpc_bench.load_results(place).experiment
    (point,) = experiment.points
    return {
        "name": experiment.name,
        "title": experiment.title,
        "seed": point.seed,
        "methods": dict.fromkeys(experiment.methods, {"parameters": "default"}),
        "metrics": [
            {"name": each.name, "unit": each.unit, "better": each.direction, "may_not_occur": each.may_not_occur}
            for each in point.metrics
        ],
        "statistics": {"primary": "mse", "baseline": "S-MPC"},
        "uncertainty": LAWS,
        "random_besides": list(point.random_besides),
    }


def published_tables(directory):
    """Return name -> bytes of the tables, without the comments of LaTeX, which name the experiment."""
    names = ["summary.csv", "comparisons.csv", "drivers.csv", "uncertainty.csv"]
    files = [*(directory / name for name in names), *sorted((directory / "tables").iterdir())]
    return {
        file.name: [
            line for line in file.read_bytes().splitlines() if not (file.suffix == ".tex" and line[:2] == b"% ")
        ]
        for file in files
    }


def wide(rows):
    """Return a row per run, with a column per metric and method."""
    metrics = ["mse", "settling_time", "input_power", "status"]
    table = rows.pivot(index="run", columns="method", values=metrics)
    table.columns = [f"{metric}_{method}" for metric, method in table.columns]
    return table.reset_index().merge(rows.drop_duplicates("run")[["run", *LAWS]], on="run")


FORMS = {
    "long": (lambda rows: rows.to_csv(index=False).encode(), "runs.csv", {}),
    "shuffled": (lambda rows: rows.sample(frac=1, random_state=3).to_csv(index=False).encode(), "runs.csv", {}),
    "from 1, with an index": (lambda rows: rows.assign(run=rows["run"] + 1).to_csv().encode(), "runs.csv", {}),
    "texts as runs": (
        lambda rows: rows.assign(run="r" + rows["run"].astype(str)).to_csv(index=False).encode(),
        "a.csv",
        {},
    ),
    "compressed": (lambda rows: gzip.compress(rows.to_csv(index=False).encode()), "runs.csv.gz", {}),
    "semicolons, decimal commas": (
        lambda rows: rows.to_csv(index=False, sep=";", decimal=",", lineterminator="\r\n").encode("utf-8-sig"),
        "runs.csv",
        {"decimal": ",", "separator": ";"},
    ),
    "other names": (
        lambda rows: rows.rename(columns={"run": "Run", "method": "Filter, <b>"}).to_csv(index=False).encode(),
        "runs.csv",
        {"columns": {"run": "Run", "method": "Filter, <b>"}},
    ),
    "wide": (lambda rows: wide(rows).to_csv(index=False).encode(), "runs.csv", {"wide": "{metric}_{method}"}),
    "several rows of a run": (
        lambda rows: pd.concat([rows.assign(stop=1), rows.assign(mse=7.0, stop=0)]).to_csv(index=False).encode(),
        "runs.csv",
        {"keep_last": "stop"},
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_the_same_trials_give_the_same_tables(native, tmp_path, form):
    place, rows = native
    write, name, options = FORMS[form]
    (tmp_path / name).write_bytes(write(rows))
    results = rmpc_bench.import_runs(tmp_path / name, directory=tmp_path / "o", settings=settings_of(place), **options)
    rmpc_bench.publish(results)
    assert published_tables(tmp_path / "o") == published_tables(place)
    assert results.is_final


def test_runs_with_known_laws_are_adjusted_for(tmp_path):
    text = Path("README.md").read_text(encoding="utf-8").split("```yaml servo.yaml\n")[1].split("```")[0]
    (tmp_path / "servo.yaml").write_text(text, encoding="utf-8")
    place, laws = tmp_path / "native", {"eps": "+-20%", "eps_load": "+-80%"}
    rmpc_bench.publish(rmpc_bench.run(rmpc_bench.load_config(tmp_path / "servo.yaml"), directory=place, jobs=1))
    drawn = pd.read_csv(place / "uncertainty.csv", **EXACT_NUMBERS)
    rows = pd.read_csv(place / "trials.csv", **EXACT_NUMBERS).merge(drawn, on="run")
    given, found = settings_of(place), {}
    for name, changes in {"all": {}, "noise": {"random_besides": ["noise"]}, "no laws": {"uncertainty": {}}}.items():
        settings = {**given, "uncertainty": laws} | changes
        rmpc_bench.publish(rmpc_bench.import_runs(rows, directory=tmp_path / name, settings=settings))
        found[name] = pd.read_csv(tmp_path / name / "comparisons.csv").iloc[0]
    assert published_tables(tmp_path / "all") == published_tables(place)
    assert (found["all"]["rests_on"], found["all"]["adjusted_for"]) == ("adjusted", "eps eps_load")
    assert found["all"]["change_pct"] == pytest.approx(-9.836, abs=5e-4)
    assert "rests_on" not in found["no laws"]
    # Two degrees do not depend on what else is random.
    assert found["noise"]["ci_low"] == found["all"]["ci_low"] < found["no laws"]["ci_high"]


def test_a_data_frame_and_a_file_of_parquet_are_tables(native, tmp_path):
    place, rows = native
    results = rmpc_bench.import_runs(rows, directory=tmp_path / "frame", settings=settings_of(place))
    rmpc_bench.publish(results)
    assert published_tables(tmp_path / "frame") == published_tables(place)
    assert gzip.decompress((tmp_path / "frame" / "source.csv.gz").read_bytes()) == rows.to_csv(index=False).encode()
    pytest.importorskip("pyarrow")
    rows.assign(nested=[[1, 2]] * len(rows)).to_parquet(tmp_path / "runs.parquet")
    results = rmpc_bench.import_runs(tmp_path / "runs.parquet", directory=tmp_path / "p", settings=settings_of(place))
    rmpc_bench.publish(results)
    assert published_tables(tmp_path / "p") == published_tables(place)


def test_words_of_other_programs_for_runs_that_finished(native, tmp_path):
    _, rows = native
    rows = rows[["run", "method", "mse"]].assign(status=np.where(rows["status"] == "ok", 1, 0))
    for name, words in (("numbers", {}), ("words", {1: True, 0: False}), ("texts", {1: "", 0: "no step found"})):
        frame = rows.assign(status=rows["status"].map(words)) if words else rows
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
        found = rmpc_bench.import_runs(tmp_path / f"{name}.csv", directory=tmp_path / name)
        assert [found.trials.n_failed(each) for each in found.trials.methods] == [2, 2, 2]


def test_without_settings_columns_are_sorted_by_what_they_have(native, tmp_path):
    _, rows = native
    rows = rows.drop(columns="settling_time").assign(note="=cmd|' /C calc'!A0", constant=3.0)
    rows.to_csv(tmp_path / "my runs.csv", index=False)
    results = rmpc_bench.import_runs(tmp_path / "my runs.csv", directory=tmp_path / "o")
    (point,) = results.experiment.points
    assert [each.name for each in point.metrics] == ["mse", "input_power"]
    assert point.uncertainty == tuple(LAWS)
    assert (results.experiment.name, results.experiment.baseline) == ("my_runs", "S-MPC")
    assert point.random_besides is None
    found = json.loads((tmp_path / "o" / "manifest.json").read_text())
    assert found["origin"] == "imported"
    assert found["sources"][0]["rows"] == 72


def test_original_names_and_reasons_stay(tmp_path):
    lines = ["run,method,status,mse", "a,KF,,1", "b,KF,no solution,9", "a,R,ok,2", "b,R,diverged,"]
    (tmp_path / "runs.csv").write_text("\n".join(lines))
    results = rmpc_bench.import_runs(tmp_path / "runs.csv", directory=tmp_path / "o")
    rmpc_bench.publish(results)
    rows = pd.read_csv(tmp_path / "o" / "trials.csv")
    assert rows["run_name"].tolist() == ["a", "b", "a", "b"]
    assert rows["status"].tolist() == ["ok", "crashed", "ok", "diverged"]
    assert np.isnan(rows["mse"][1])
    assert "no solution" in (tmp_path / "o" / "failures" / "KF-1.txt").read_text()


def test_a_sweep_has_points_in_the_order_of_their_values(tmp_path):
    rows = [(q, m, run, q * (1 + run % 7) + (m == "R")) for q in (10, 2) for m in ("KF", "R") for run in range(9)]
    frame = pd.DataFrame(rows, columns=["sweep:plant.q", "method", "run", "mse"])
    results = rmpc_bench.import_runs(frame, directory=tmp_path / "a")
    assert [dict(each.coordinates) for each in results.experiment.points] == [{"plant.q": "2"}, {"plant.q": "10"}]
    given = {"sweep": {"grid": {"plant.q": [10, 2]}}}
    frame = frame.rename(columns={"sweep:plant.q": "plant.q"})
    results = rmpc_bench.import_runs(frame, directory=tmp_path / "b", settings=given)
    assert [each.title for each in results.experiment.points] == ["plant.q=10", "plant.q=2"]
    assert results.n_complete == {"KF": 9, "R": 9}


def test_missing_rows_are_left_out_or_count_as_failed(tmp_path):
    frame = pd.DataFrame({"run": [5, 6, 7, 5, 7, 6], "method": ["A"] * 3 + ["B"] * 3, "mse": [1, 2, 3, 2, 3, np.nan]})
    with pytest.raises(ConfigError, match="a metric of a finished run is empty"):
        rmpc_bench.import_runs(frame, directory=tmp_path / "a")
    dropped = rmpc_bench.import_runs(frame, directory=tmp_path / "b", missing="drop")
    assert (dropped.experiment.n_runs, dropped.trials.run_names) == (2, (5, 7))
    with pytest.raises(ConfigError, match="--missing drop leaves no run"):
        rmpc_bench.import_runs(frame[1:5:2], directory=tmp_path / "d", missing="drop", metrics=["mse"])
    failed = rmpc_bench.import_runs(frame[:5], directory=tmp_path / "c", missing="failed")
    assert (failed.trials.n_failed("B"), failed.incomplete) == (1, ())


def test_a_run_that_a_point_lacks_is_left_out_or_failed_at_all_points(tmp_path):
    rows = [(q, m, run, q + run % 3 + (m == "R")) for q in (1, 2) for m in ("KF", "R") for run in range(6)]
    frame = pd.DataFrame(rows[:-1], columns=["sweep:q", "method", "run", "mse"])
    dropped = rmpc_bench.import_runs(frame, directory=tmp_path / "a", missing="drop")
    assert (dropped.extent.text, dropped.incomplete) == ("5 of 5 runs at each of 2 points", ())
    failed = rmpc_bench.import_runs(
        frame[frame["run"] + frame["sweep:q"] < 7], directory=tmp_path / "b", missing="failed"
    )
    assert (failed.extent.text, failed.incomplete) == ("6 of 6 runs at each of 2 points", ())


def test_the_last_named_run_may_be_left_out(tmp_path):
    frame = pd.DataFrame({"run": [*"abcab"], "method": [*"AAABB"], "mse": [1.0, 2.0, 3.0, 4.0, 6.0]})
    dropped = rmpc_bench.import_runs(frame, directory=tmp_path / "o", missing="drop")
    assert (dropped.experiment.n_runs, dropped.experiment.imported.names) == (2, ("a", "b"))


def test_a_stated_law_adjusts_the_comparison(tmp_path):
    rng = np.random.default_rng(2)
    u = rng.uniform(-0.2, 0.2, 100)
    mse = [np.exp(u * u), np.exp(u * u + u + 0.001 * rng.standard_normal(100) - 0.1)]
    parts = [pd.DataFrame({"run": range(100), "method": m, "u": u, "mse": x}) for m, x in zip("AB", mse, strict=True)]
    frame = pd.concat(parts, ignore_index=True)
    plain = rmpc_bench.import_runs(frame, directory=tmp_path / "a")
    adjusted = rmpc_bench.import_runs(frame, directory=tmp_path / "b", settings={"uncertainty": {"u": "+-20%"}})
    rows = [rmpc_bench.compare(each, "mse").to_frame().iloc[0] for each in (plain, adjusted)]
    widths = [row["ci_high"] - row["ci_low"] for row in rows]
    assert [row["rests_on"] for row in rows] == ["plain", "adjusted"]
    assert widths[1] < 0.1 * widths[0]
    assert rows[1]["change_pct"] == pytest.approx(100 * np.expm1(-0.1), abs=0.1)  # 3 standard errors are 0.03


def test_a_parameter_without_a_law_is_not_adjusted_for(tmp_path):
    frame = pd.DataFrame({"run": [1, 2] * 2, "method": [*"AABB"], "eps": [0.1, 0.2] * 2, "mse": [1.0, 2.0, 3.0, 5.0]})
    found = "'eps' is not an uncertain quantity; give its law in `uncertainty`"
    with pytest.raises(ConfigError, match=f"statistics.adjust.0: {found}"):
        rmpc_bench.import_runs(frame, directory=tmp_path / "o", settings={"statistics": {"adjust": ["eps"]}})


@pytest.mark.parametrize("word", ["0", "false", "False"])
def test_a_logical_status_is_no_reason(tmp_path, word):
    text = HEAD + "1,A,0,1\n2,A,0,2\n1,B,0,1.5\n2,B,0,NaN\n"
    lines = [f"{line},{each}" for line, each in zip(text.splitlines(), ["status", "1", "1", "1", word], strict=True)]
    (tmp_path / "runs.csv").write_text("\r\n".join(lines))
    results = rmpc_bench.import_runs(tmp_path / "runs.csv", directory=tmp_path / "o")
    assert [each.message for each in results.trials.notes["B"].failures] in ([], [""])
    assert results.trials.n_failed("B") == 1


@pytest.mark.long
def test_a_table_may_have_thousands_of_columns(tmp_path):
    more = {f"c{number}": [0.0, number] for number in range(5000)}
    frame = pd.DataFrame({"run": 1, "method": ["A", "B"], "mse": [1.0, 2.0], **more})
    frame.to_csv(tmp_path / "runs.csv", index=False)
    results = rmpc_bench.import_runs(tmp_path / "runs.csv", directory=tmp_path / "o", metrics=["mse"])
    assert [each.name for each in results.trials.metrics] == ["mse"]
    remarks = prepare_import(tmp_path / "runs.csv", tmp_path / "o", metrics=["mse"])[0].remarks
    assert remarks[9:] == ["column 'c9' is ignored: it is not named with --metric", "and 4,990 more remarks"]


def message(tmp_path, text, given=None, name="runs.csv", **options):
    """Return the message of a table that is refused, with the name of its file only."""
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError) as refused:
        rmpc_bench.import_runs(tmp_path / name, directory=tmp_path / "o", settings=given, **options)
    assert not (tmp_path / "o").exists()
    return str(refused.value).replace(f"{tmp_path}/", "")


HEAD = "run,method,eps,mse\n"


def test_all_mistakes_of_rows_are_named_with_their_lines(tmp_path):
    text = HEAD + "7,S-MPC,0.3,1\n8,S-MPC,0.25,1.5\n7,R-MPC,0.1,n/a\n7,R-MPC,0.1,3\n9,S-MPC,1,2\n"
    found = message(tmp_path, text)
    assert found == "runs.csv:5: run 7 of R-MPC occurs twice (first in line 4)"
    text = text.replace("7,R-MPC,0.1,3\n", "")
    assert {*message(tmp_path, text, {"uncertainty": {"eps": "+-20%"}, "title": 3}).split("\n")} == {
        "runs.csv: 2 of 3 runs have no row for R-MPC (8, 9): --missing drop compares the other 1, "
        "--missing failed counts them as failed",
        "runs.csv:4: mse of R-MPC is 'n/a', no number; a failed run has a status, a missing value is empty "
        "(--missing drop|failed)",
        "runs.csv:4: eps is 0.3 for S-MPC and 0.1 for R-MPC in run 7: the methods did not have the same draws "
        "(--unpaired compares them without pairs)",
        "uncertainty.eps: 2 values of the table lie outside of +-20% (lines 3, 5): the law is not that of these runs",
        "title: must be text (got 3)",
    }


@pytest.mark.parametrize(
    ("text", "options", "expected"),
    [
        ("", {}, "runs.csv:1: is empty; the first line has the names of the columns"),
        (HEAD, {}, "runs.csv: has names of columns, and no row"),
        (b"PK\x03\x04\xff\xfe\n", {}, "runs.csv:1: is no text in UTF-8 (byte 0xff)"),
        ("Run,Filter,mse\n1,A,2\n", {}, "runs.csv: no column 'method' (Run, Filter, mse); --columns method=Filter"),
        ("run;method;mse\n1;A;0,1\n", {}, "runs.csv:1: the columns seem to be separated by ';': give --separator ';'"),
        (
            "run;method;mse\n1;A;0,1158\n",
            {"separator": ";"},
            "runs.csv:2: mse is '0,1158': with decimal commas give --decimal , and --separator ';'",
        ),
        (HEAD + "1,A,0,1\n2,A,0,2\n", {"max_rows": 1}, "runs.csv: 2 rows, at most 1 (--max-rows)"),
        (HEAD + "1,A,0,1,5\n", {}, "runs.csv:2: has 5 cells, and 4 columns have names"),
        (
            HEAD + "1,A,0,1\n2,A,0\n",
            {},
            "runs.csv:3: a metric of a finished run is empty: --missing drop leaves the run out, ",
        ),
        ("run,run,method\n1,1,A\n", {}, "runs.csv:1: the column 'run' is there 2 times"),
        ("a_b_c,run\n1,2\n", {"wide": "{metric}_{method}"}, "runs.csv:1: column 'a_b_c' may be a of b_c or a_b of c: "),
        (HEAD + '1,"A\x1b[2J",0,1\n', {}, "runs.csv:2: contains the control or invisible character U+001B "),
        (HEAD + "1,A,0,inf\n2,A,0,1\n", {}, "runs.csv:2: mse of A is inf"),
        (HEAD + "1,A,0,1\n", {"columns": {"metod": "a"}}, "--columns: 'metod' is not a known role; did you mean "),
        (HEAD + "1,A,0,1\n", {"metrics": ["msse"]}, "runs.csv:1: metric 'msse' is not a known column; did you mean "),
        (HEAD + "1,A,0,1\n", {"baseline": "B"}, "--baseline: statistics.baseline: 'B' is not a known method"),
        (HEAD + "1," + "A" * 200_000 + ",0,1\n", {}, "runs.csv:2: has more than 10000 characters (got 'AAA"),
        (HEAD + "1,A,0,1\n", {"name": "a\u202eb.csv"}, "the name of the file contains the control or invisible"),
        (HEAD + "1,A,0,1\n", {"decimal": "1"}, "--decimal: must be one sign (got '1')"),
        (HEAD + "1,A,0,1\n", {"metrics": ["mse"], "given": {"metrics": 3}}, "metrics: must be a list (got 3)"),
        (
            "sweep:q,run,method,mse\n1,1,A,1\n1,2,A,2\n2,3,A,3\n2,4,A,5\n",
            {},
            "runs.csv: 2 of 4 runs have no row for A at q=1 (3, 4): --missing drop compares the other 2, "
            "--missing failed counts them as failed; number the runs alike at all points",
        ),
    ],
)
def test_a_wrong_table_is_refused(tmp_path, text, options, expected):
    assert expected in message(tmp_path, text, **options)


@given(st.data())
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_corruptions_give_an_error_with_a_place_or_a_table(native, tmp_path_factory, data):
    _, rows = native
    good = rows[["run", "method", "status", "mse", "eps_max"]].to_csv(index=False).encode()
    place = data.draw(st.integers(0, len(good)))
    change = data.draw(
        st.sampled_from([b"", b",", b'"', b"\n", b"\0", b"\xff", b";", b"nan", b"1e999", b"-", b"\r", b"x"])
    )
    n = data.draw(st.integers(0, 40))
    folder = tmp_path_factory.mktemp("bad")
    (folder / "runs.csv").write_bytes(good[:place] + change + good[place + n :])
    try:
        found = rmpc_bench.import_runs(folder / "runs.csv", directory=folder / "o")
    except ConfigError as error:
        assert all(str(each).startswith(f"{folder}/runs.csv:") for each in error.problems)
    else:
        assert found.experiment.n_runs > 0


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"mse": 0.5}, "column 'mse' is ignored: all its cells are equal"),
        (
            {"m,s<b>": [1.0, 2, 3, 4], "mse": 1},
            "column 'm,s<b>' is ignored: the name is none of a metric; --columns 'metric:NAME=m,s<b>'",
        ),
        ({f"c{i}": [i, 1, 2, 3] for i in range(120)}, "121 metrics, at most 100; --metric names some"),
        ({f"c{i}": 1 for i in range(10_001)}, "table:1: 10,004 columns, at most 10,000"),
        ({"mse": [1.0, 2, -np.inf, 3]}, "table:3: mse of B is -inf: no number"),
        ({"method": ["A", "A", "", "B"]}, "table:3: a row has no method"),
        ({"run": [1, 2, "\u202e", 2]}, "table:3: the name of the run: contains the control or invisible character"),
    ],
)
def test_a_frame_without_a_comparison_is_refused(tmp_path, change, expected):
    frame = pd.DataFrame({"run": [1, 2, 1, 2], "method": [*"AABB"], "mse": [1.0, 2.0, 3.0, 4.0]} | change)
    with pytest.raises(ConfigError) as refused:
        rmpc_bench.import_runs(frame, directory=tmp_path / "o")
    assert expected in str(refused.value)


@pytest.mark.parametrize("change", [{"mse": 1e300}, {"status": "bad"}, {"eps": 0.0}])
def test_degenerate_tables_have_a_page(tmp_path, change):
    frame = paired(12).rename(columns={"u": "eps"}).assign(**change)
    rmpc_bench.publish(rmpc_bench.import_runs(frame, directory=tmp_path / "o", metrics=["mse"]))
    assert (tmp_path / "o" / "report.html").exists()


def paired(n, methods=("KF", "R"), seed=1):
    """Return runs of methods on the same draws: u explains most of the metric."""
    u = np.random.default_rng(seed).uniform(-1, 1, n)
    noise = np.random.default_rng(seed + 1).uniform(0.9, 1.1, (len(methods), n))
    parts = [{"run": range(n), "method": name, "u": u, "mse": np.exp(u) * noise[i]} for i, name in enumerate(methods)]
    return pd.concat([pd.DataFrame(part) for part in parts], ignore_index=True)


def test_runs_of_other_draws_and_sorted_rows_are_noticed(tmp_path):
    frame = paired(60)
    found = rmpc_bench.import_runs(frame, directory=tmp_path / "a")
    assert json.loads((tmp_path / "a" / "manifest.json").read_text())["warnings"] == []
    shuffled = frame.assign(mse=frame["mse"].where(frame["method"] == "KF", np.roll(frame["mse"], 17))).drop(
        columns="u"
    )
    found = rmpc_bench.import_runs(shuffled, directory=tmp_path / "b")
    rmpc_bench.publish(found)
    (text,) = json.loads((tmp_path / "b" / "manifest.json").read_text())["warnings"]
    assert text.startswith("run i of R has nothing in common with run i of KF (rank correlation ")
    page = (tmp_path / "b" / "report.md").read_text()
    assert "un i of R has nothing in common" in page
    assert "**Runs made elsewhere,** not simulated by rmpc-bench." in page
    rows = frame.sort_values(["method", "mse"]).drop(columns=["run", "u"])
    expected = "table: mse rises from row to row for KF and R: the rows look sorted, so that intervals would be far too"
    with pytest.raises(ConfigError, match=expected):
        rmpc_bench.import_runs(rows, directory=tmp_path / "c")


def test_methods_and_runs_are_added(tmp_path):
    frame = paired(40, ("KF", "R", "S"))
    whole = rmpc_bench.import_runs(frame, directory=tmp_path / "whole", settings={"name": "x"})
    first = frame[(frame["method"] != "S") & (frame["run"] < 30)]
    rmpc_bench.publish(rmpc_bench.import_runs(first, directory=tmp_path / "o", settings={"name": "x"}))
    with pytest.raises(StoreError, match="--add adds"):
        rmpc_bench.import_runs(frame, directory=tmp_path / "o")
    rmpc_bench.import_runs(frame[(frame["method"] == "S") & (frame["run"] < 30)], directory=tmp_path / "o", add=True)
    found = rmpc_bench.import_runs(frame[frame["run"] >= 20], directory=tmp_path / "o", add=True)
    assert found.experiment.hash == whole.experiment.hash
    pd.testing.assert_frame_equal(found.trials.frame, whole.trials.frame, check_exact=True)
    pd.testing.assert_frame_equal(found.uncertainty, whole.uncertainty, check_exact=True)
    assert found.trials.look == 2
    for change, error in (({"mse": 1.0}, StoreError), ({"u": 0.5, "run": 99}, ConfigError)):
        with pytest.raises(error):
            rmpc_bench.import_runs(frame[:1].assign(**change), directory=tmp_path / "o", add=True)
