"""What the verbs do with runs that were made elsewhere."""

import json
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import rmpc_bench
from rmpc_bench.cli import main
from rmpc_bench.received.store import MissingError
from rmpc_bench.types import ConfigError, DesignError


def call(*words):
    """Return exit code and output of a command."""
    found = CliRunner().invoke(main, [*map(str, words)])
    return found.exit_code, found.output


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """A table of two methods, with a failed run and a method whose name is HTML."""
    rng, place = np.random.default_rng(3), tmp_path_factory.mktemp("table") / "runs.csv"
    u = rng.uniform(-1, 1, 30)
    parts = [
        pd.DataFrame({"Run": np.arange(1, 31), "method": name, "status": "", "u": u, "mse": np.exp(u) * factor})
        for name, factor in (("KF", 1.0), ("<b>R</b>", rng.uniform(0.7, 0.9, 30)))
    ]
    frame = pd.concat(parts, ignore_index=True)
    frame.loc[4, ["status", "mse"]] = ["=cmd|' /C calc'!A0", np.nan]
    frame.to_csv(place, index=False)
    return place


@pytest.fixture(scope="module")
def directory(table):
    """The directory of results of this table."""
    claims = [{"says": "R is better", "source": "Sec. 1", "check": "mean(mse[<b>R</b>]) < mean(mse[KF])"}]
    place = table.with_name("results")
    settings = {"title": "Two filters", "claims": claims}
    table.with_name("settings.yaml").write_text("version: 1\ntitle: Two filters\n")
    code, text = call(
        "import", table, "-o", place, "--columns", "run=Run", "--settings", table.with_name("settings.yaml")
    )
    assert (code, settings["title"]) == (0, "Two filters"), text
    return place


def test_a_row_that_cannot_be_added_names_the_table_and_the_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frame = pd.DataFrame(
        {"run": [1, 2] * 2, "method": ["P", "P", "Q", "Q"], "eps": [0.1, 0.2] * 2, "mse": [1, 2, 3, 5]}
    )
    frame.to_csv("runs.csv", index=False)
    frame[:2].assign(method="R", eps=[0.1, 0.3]).to_csv("more.csv", index=False)
    assert call("import", "runs.csv", "-o", "o")[0] == 0
    before = Path("o/trials.sqlite").read_bytes()
    assert call("import", "more.csv", "-o", "o", "--add") == (
        2,
        "more.csv and o: eps is 0.2 for P and 0.3 for R in run 2: the methods did not have the same draws "
        "(--unpaired compares them without pairs)\n",
    )
    assert Path("o/trials.sqlite").read_bytes() == before


def test_names_of_runs_that_are_not_those_of_the_runs_are_damage(directory, tmp_path):
    place = Path(shutil.copytree(directory, tmp_path / "o"))
    with closing(sqlite3.connect(place / "trials.sqlite")) as store, store:
        store.execute("update meta set value = json_set(value, '$.imported.names', json('[1]')) where key = 'layout'")
    code, text = call("report", place)
    assert (code, "imported.names: there are 1 names of 30 runs" in text) == (2, True), text


def test_a_table_becomes_a_directory_with_a_page(table, directory):
    page = (directory / "report.html").read_text()
    assert "not simulated by rmpc-bench" in page
    assert "their draws, their code and its versions are not known here" in page
    assert "<b>R</b>" not in page.replace("&lt;b&gt;", "")
    assert f"rmpc-bench import {table} --columns run=Run" in page
    assert json.loads((directory / "manifest.json").read_text())["sources"][0]["options"] == {"columns": {"run": "Run"}}
    names = {path.name for path in directory.iterdir()}
    assert {"config.yaml", "manifest.json", "trials.sqlite", "source.csv.gz", "progress.json"} <= names
    assert not {"config.resolved.yaml", "traces.npz", "timings.csv"} & names
    assert "=cmd" not in (directory / "trials.csv").read_text()


def test_the_dry_run_writes_nothing(table, tmp_path):
    code, text = call("import", table, "-o", tmp_path / "o", "-n")
    assert code == 0
    assert "60 runs, 1 failed\nmethods: KF, <b>R</b>\nmetrics: mse\nparameters: Run, u\nnothing is written" in text
    assert not (tmp_path / "o").exists()


def test_verbs_that_simulate_refuse(directory, tmp_path):
    expected = (
        f"{directory} holds runs made elsewhere; add methods with `rmpc-bench import more.csv -o {directory} --add`"
    )
    for words in (("run", "quickstart", "-o", directory), ("merge", directory)):
        code, text = call(*words)
        assert (code, expected in text) == (2, True), text
    code, text = call("show", directory, "--run", 3, "--method", "KF", "--plot", tmp_path / "a.svg")
    assert (code, expected in text) == (2, True), text
    with pytest.raises(MissingError, match="made elsewhere"):
        rmpc_bench.replay(directory, 0, "KF")


def test_show_has_the_row_of_the_table(directory):
    """Oracle: the runs 1 to 30 of the table have the indices 0 to 29."""
    code, text = call("show", directory, "--run", 4, "--method", "KF")
    assert (code, text.splitlines()[:3]) == (
        0,
        [
            "run 4, 5 in the table, of KF: crashed, as the table says",
            "the run that the table calls 4 is --run 3 here",
            "=cmd|' /C calc'!A0",
        ],
    )
    assert call("show", directory, "--run", 30, "--method", "KF")[1].startswith("run 29, 30 in the table, of KF: ok")
    code, text = call("show", directory, "--run", "31", "--method", "KF")
    assert (code, "there is no run 31 of KF there" in text) == (2, True)
    assert call("show", directory, "--run", 3, "--method", "LQG")[0] == 2


def test_show_takes_the_name_of_a_run(tmp_path, monkeypatch):
    """Oracle: the indices of texts are in the order of their rows."""
    monkeypatch.chdir(tmp_path)
    frame = pd.DataFrame({"run": [*"bac"] * 2, "method": [*"PPPQQQ"], "mse": [1, 9, 3, 2, 8, 4]})
    frame.to_csv("runs.csv", index=False)
    assert call("import", "runs.csv", "-o", "o")[0] == 0
    shown = ["run 1, a in the table, of Q: ok, as the table says", "mse = 8"]
    assert [call("show", "o", "--run", run, "--method", "Q")[1].splitlines() for run in ("a", 1)] == [shown] * 2
    assert "there is no run d of Q there" in call("show", "o", "--run", "d", "--method", "Q")[1]


def test_a_file_in_place_of_the_directory_is_a_mistake_of_the_user(table, tmp_path):
    place = tmp_path / "file"
    place.touch()
    for chosen in (place, place / "below"):
        code, text = call("import", table, "-o", chosen)
        assert (code, text.splitlines()[-1]) == (
            2,
            f"{chosen}: a file is in the place of this directory; choose another one",
        )
    assert place.read_bytes() == b""


def test_status_report_and_compare_take_the_directory(directory, tmp_path):
    assert "60 of 60 trials (100 %), 1 failed (crashed 1)" in call("status", directory)[1]
    assert "raised an exception" not in (directory / "tables/summary.md").read_text(encoding="utf-8")
    assert call("report", directory, "--to", tmp_path / "again")[0] == 0
    assert (tmp_path / "again" / "comparisons.csv").read_bytes() == (directory / "comparisons.csv").read_bytes()
    code, text = call("compare", directory, directory)
    assert (code, "60 trials in both" in text) == (0, True)


def test_improvements_are_paired_where_names_and_parameters_agree(directory, table, tmp_path):
    a = rmpc_bench.load_results(directory)
    frame = pd.read_csv(table).rename(columns={"Run": "run"})
    for changed, paired in (
        (frame, True),
        (frame.assign(u=-frame["u"]), False),
        (frame.assign(run=frame["run"] + 1), False),
    ):
        b = rmpc_bench.import_runs(changed, directory=tmp_path / str(len([*tmp_path.iterdir()])))
        (row,) = rmpc_bench.compare_improvements(a, b, "<b>R</b>").rows
        assert row.paired is paired


def test_a_pack_is_verified_from_its_table(directory, tmp_path):
    pytest.importorskip("rocrate")
    rmpc_bench.pack(directory, tmp_path / "runs.zip")
    found = rmpc_bench.verify(tmp_path / "runs.zip")
    assert found.reproduced, found
    assert "the runs were made elsewhere and were not repeated: their table was read again" in str(found)
    assert rmpc_bench.verify(tmp_path / "runs.zip", simulate=False).reproduced
    assert call("verify", tmp_path / "runs.zip", "--runs", 2)[0] == 2


def test_results_of_a_simulation_are_not_replaced(table, tmp_path):
    config = rmpc_bench.load_config("configs/quickstart.yaml", runs=2)
    rmpc_bench.run(config, directory=tmp_path / "o", jobs=1)
    code, text = call("import", table, "-o", tmp_path / "o")
    assert (code, "holds an experiment that was simulated" in text) == (5, True)


def test_claims_rest_on_metrics(table, tmp_path):
    settings = {"columns": {"run": "Run"}, "directory": tmp_path / "o"}
    claim = {
        "says": "better",
        "source": "Sec. 1",
        "check": "mean(mse[<b>R</b>]) < mean(mse[KF])",
        "finding": "confirmed",
    }
    results = rmpc_bench.import_runs(table, settings={"claims": [claim]}, **settings)
    assert [str(each.finding) for each in rmpc_bench.judge(results)] == ["confirmed"]
    with pytest.raises(ConfigError, match="'P' is not a known metric or series"):
        rmpc_bench.import_runs(table, settings={"claims": [claim | {"check": "last(P[KF]) < 1"}]}, **settings)


def test_a_link_in_the_directory_is_not_followed(table, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / "o").mkdir()
    for name in ("source.csv.gz", "manifest.json", "config.yaml"):
        (tmp_path / "o" / name).symlink_to(victim)
    try:
        rmpc_bench.import_runs(table, directory=tmp_path / "o")
    except rmpc_bench.received.plain_files.DamagedError:
        pass
    assert victim.read_text() == "mine"


def test_arguments_are_checked(table, tmp_path):
    with pytest.raises(DesignError, match="give the directory"):
        rmpc_bench.import_runs(table, add=True)
    code, text = call("import", table, "--columns", "run")
    assert (code, "expected ROLE=COLUMN" in text) == (2, True)


def test_benchopt(tmp_path):
    pytest.importorskip("pyarrow")
    names = ["solver_name", "idx_rep", "stop_val", "time", "objective_value", "env-OMP_NUM_THREADS", "objective_name"]
    rows = [
        (f"GD[step={step},use_acc=False]", rep, stop, 0.1 * stop, (rep + 2) / step / stop, 4, "lasso")
        for step in (1, 2)
        for rep in range(12)
        for stop in (1, 5, 10)
    ]
    pd.DataFrame(rows, columns=names).to_parquet(tmp_path / "run.parquet")
    options = {"columns": {"run": "idx_rep", "method": "solver_name"}, "keep_last": "stop_val"}
    results = rmpc_bench.import_runs(
        tmp_path / "run.parquet", directory=tmp_path / "o", metrics=["objective_value"], **options
    )
    assert results.trials.methods == ("GD(step=1 use_acc=False)", "GD(step=2 use_acc=False)")
    assert results.trials.column("objective_value", "GD(step=1 use_acc=False)").tolist() == [
        (i + 2) / 10 for i in range(12)
    ]


def test_the_import_of_the_package_imports_no_pandas():
    code = (
        "import sys, rmpc_bench.cli.import_table; sys.exit(any(each in sys.modules for each in ('pandas', 'pyarrow')))"
    )
    assert (
        subprocess.run([sys.executable, "-c", code], cwd=Path(rmpc_bench.__file__).parents[1], check=False).returncode
        == 0
    )
