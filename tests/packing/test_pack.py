"""rmpc-bench pack and verify: an archive that reproduces elsewhere, and every kind of difference found."""

import json
import os
import platform
import shutil

import forged_packs
import packed
import pytest
from execution.test_own_experiment import written
from small_experiment import cli, ran, write

CLAIMS = """
  - {id: better, says: R-MPC wins, source: s, check: 'mean(mse[R-MPC]) < mean(mse[S-MPC])', finding: confirmed}
  - {says: S-MPC uses energy, source: s, check: 'min(input_power[S-MPC]) > 0', finding: confirmed}
"""
TIME = "{step: 0.1, steps: 80}"
SWEEP = "{grid: {controller.Hp: [5, 10]}}"


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """Results of the small experiment and their archive; tests copy what they change."""
    there = tmp_path_factory.mktemp("pack")
    path = write(
        there, runs=12, time=TIME, claims=CLAIMS, metrics="[mse, input_power, settling_time]", paper="zenere2018"
    )
    ran(path, there / "out")
    done = cli("pack", there / "out", "-o", there / "tiny.zip", "--author", "A. Author", "--licence", "CC-BY-4.0")
    assert done.exit_code == 0, done.output
    return there


@pytest.fixture
def archive(here, tmp_path):
    """A copy of the archive, in an empty directory."""
    return shutil.copy(here / "tiny.zip", tmp_path / "tiny.zip")


def changed_digit(content):
    """Another seventh decimal of the first mse in trials.csv."""
    lines = content.decode().splitlines(keepends=True)
    cells = lines[1].split(",")
    place = cells[3].index(".") + 7
    cells[3] = f"{cells[3][:place]}{(int(cells[3][place]) + 1) % 10}{cells[3][place + 1 :]}"
    return "".join([lines[0], ",".join(cells), *lines[2:]]).encode()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.long
def test_an_archive_is_an_ro_crate(here, monkeypatch):
    pytest.importorskip("rocrate_validator")
    for profile in ("ro-crate-1.1", "process-run-crate-0.5"):
        assert packed.crate_issues(here / "tiny.zip", profile, monkeypatch) == []


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_check_of_the_crate_finds_a_mistake(here, tmp_path, monkeypatch):
    """Without the description of the root the validator is not satisfied."""
    pytest.importorskip("rocrate_validator")

    def without(content):
        data = json.loads(content)
        data["@graph"] = [{key: entity[key] for key in entity if key != "license"} for entity in data["@graph"]]
        return json.dumps(data).encode()

    found = packed.contents(here / "tiny.zip")
    name = "ro-crate-metadata.json"
    path = packed.write(tmp_path / "x.zip", found | {name: without(found[name])})
    assert packed.crate_issues(path, "ro-crate-1.1", monkeypatch)


def test_what_an_archive_has(here):
    found = packed.contents(here / "tiny.zip")
    needed = {"config.yaml", "config.resolved.yaml", "trials.csv", "manifest.json", "claims.json", "report.html"}
    assert needed <= found.keys() and "CITATION.cff" in found and not any("sqlite" in name for name in found)
    metadata = json.loads(found["ro-crate-metadata.json"])
    entities = {entity["@id"]: entity for entity in metadata["@graph"]}
    assert entities["./"]["license"] == {"@id": "https://spdx.org/licenses/CC-BY-4.0"}
    assert entities["./"]["citation"] == {"@id": "https://arxiv.org/abs/1804.06746"}
    assert entities["#author-1"]["name"] == "A. Author"
    assert b"- name: A. Author" in found["CITATION.cff"] or b"{name: A. Author}" in found["CITATION.cff"]


def test_the_same_results_give_the_same_bytes(here, tmp_path):
    for name in ("a.zip", "b.zip"):
        assert cli("pack", here / "out", "-o", tmp_path / name).exit_code == 0
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()


def test_a_new_computation_reproduces_it(archive):
    found = cli("verify", archive, "-j", 1)
    assert found.exit_code == 0, found.output
    assert "reproduced   all 12 runs, 2 methods" in found.stdout
    assert "24 statuses, 72 values of metrics (all equal)\n30 files: 26 compared, equal bytes" in found.stdout
    (record,) = json.loads(packed.contents(archive)["verified_on.json"])
    assert record["result"] == "reproduced" and record["compared"] == {"trials": 24, "values": 72, "files": 26}
    assert record["versions"]["numpy"] and record["machine"]["system"] and record["date"].startswith("20")
    assert os.uname().nodename not in json.dumps(record)


def test_fewer_runs_and_single_claims(archive):
    assert "reproduced   runs 0 to 4 of 12, 2 methods" in cli("verify", archive, "--runs", 5, "-j", 1).stdout
    found = cli("verify", archive, "--claim", "better", "-j", 1)
    assert "reproduced   all 12 runs, 2 methods, claim better" in found.stdout and "1 claim" in found.stdout
    found = cli("verify", archive, "--claim", 2, "--runs", 3, "-j", 1)
    assert "reproduced   runs 0 to 2 of 12, 1 method, claim 2" in found.stdout
    assert "3 statuses" in found.stdout, found.stdout
    assert len(json.loads(packed.contents(archive)["verified_on.json"])) == 3
    wrong = cli("verify", archive, "--claim", "bettre")
    assert wrong.exit_code == 2 and "did you mean 'better'?" in wrong.stderr


@pytest.mark.parametrize("options", [("-j", 1), ("--no-run",)])
def test_a_digit_that_was_altered_is_found(archive, tmp_path, options):
    path = packed.altered(archive, tmp_path / "bad.zip", trials__csv=changed_digit)
    found = cli("verify", path, *options)
    assert found.exit_code == 1 and "bad.zip: different" in found.stdout
    assert "trials.csv: its content is not what was packed" in found.stdout


def test_a_digit_is_found_where_the_hashes_fit(archive, tmp_path):
    """The run and both values are named."""
    path = packed.altered(archive, tmp_path / "bad.zip", honest=True, trials__csv=changed_digit)
    found = cli("verify", path, "-j", 1)
    assert found.exit_code == 1 and "not what was packed" not in found.stdout
    assert "S-MPC mse: 1 of 12 runs, run 0: packed 0." in found.stdout
    assert json.loads(packed.contents(path)["verified_on.json"])[0]["result"] == "different"


def test_a_first_digit_is_found_without_a_computation(archive, tmp_path):
    """The mean of the rows is not that of summary.csv."""

    def doubled(content):
        lines = content.decode().splitlines(keepends=True)
        cells = lines[1].split(",")
        return "".join([lines[0], ",".join([*cells[:3], repr(2 * float(cells[3])), *cells[4:]]), *lines[2:]]).encode()

    path = packed.altered(archive, tmp_path / "bad.zip", honest=True, trials__csv=doubled)
    found = cli("verify", path, "--no-run")
    assert found.exit_code == 1 and "S-MPC mse mean: summary.csv" in found.stdout
    assert cli("verify", archive, "--no-run").exit_code == 0


def test_a_status_a_finding_a_printed_digit_and_a_series_are_found(archive, tmp_path):
    changes = {
        "trials__csv": lambda text: text.replace(b"R-MPC,1,ok,", b"R-MPC,1,diverged,", 1),
        "claims__json": lambda text: text.replace(b'"finding": "', b'"finding": "not-', 1),
        "summary__csv": lambda text: text.replace(b"S-MPC,mse,12", b"S-MPC,mse,13", 1),
        "series__csv": lambda text: text.replace(b"0.", b"1.", 1),
    }
    path = packed.altered(archive, tmp_path / "bad.zip", honest=True, **changes)
    found = cli("verify", path, "-j", 1)
    assert found.exit_code == 1
    for text in (
        "R-MPC run 1: packed diverged, here ok",
        """claims.json: line 30: packed '      "finding": "not-inconclusive",'""",
        "summary.csv: line 2: packed 'S-MPC,mse,13,",
        "series.csv: line 2: packed 'S-MPC,K,",
    ):
        assert text in found.stdout, found.stdout


def test_a_time_that_moved_by_one_sample_is_a_difference(here, archive, tmp_path):
    """Also on another machine, where a threshold may be crossed one sample later: the metric and the run are named."""
    rows = (here / "out" / "trials.csv").read_text("utf-8").splitlines()
    line = next(row for row in rows[1:] if not row.endswith("inf"))
    value = float(line.split(",")[-1])

    def later(samples):
        other = ",".join([*line.split(",")[:-1], repr(round(value + 0.1 * samples, 9))])
        return lambda text: text.replace(line.encode(), other.encode())

    def verified(samples, **changes):
        path = packed.altered(archive, tmp_path / "x.zip", honest=True, trials__csv=later(samples), **changes)
        return cli("verify", path, "-j", 1)

    elsewhere = {"manifest__json": lambda text: text.replace(f'"{platform.machine()}"'.encode(), b'"other"')}
    for found in (verified(1), verified(1, **elsewhere)):
        assert found.exit_code == 1 and "\nmetrics\n  S-MPC settling_time: 1 of 12 runs" in found.stdout, found.stdout


def test_sweeps_and_exact_moments(tmp_path):
    """A claim about one point of a sweep needs this point only."""
    claim = "[{id: p, says: s, source: s, check: 'mean(mse[R-MPC, controller.Hp=5]) > 0', finding: confirmed}]"
    path = write(tmp_path, sweep=SWEEP, claims=claim)
    ran(path, tmp_path / "out")
    assert cli("pack", tmp_path / "out", "-o", tmp_path / "s.zip").exit_code == 0
    found = cli("verify", tmp_path / "s.zip", "-j", 1)
    assert found.exit_code == 0 and "24 statuses" in found.stdout, found.output
    found = cli("verify", tmp_path / "s.zip", "--claim", "p", "-j", 1)
    assert found.exit_code == 0 and "6 statuses" in found.stdout, found.output
    assert cli("verify", tmp_path / "s.zip", "--no-run").exit_code == 0


def test_own_files_need_consent_and_data_files_come_along(tmp_path):
    """The archive is checked where the configuration and its files do not exist."""
    place = tmp_path / "mine"
    place.mkdir()
    ran(written(place), tmp_path / "out")
    file = tmp_path / "tank.zip"
    done = cli("pack", tmp_path / "out", "-o", file)
    assert done.exit_code == 0, done.output
    assert done.stdout.endswith(f"rmpc-bench verify {file} --allow-code {file}\n")
    shutil.rmtree(place)
    shutil.rmtree(tmp_path / "out")
    names = packed.contents(tmp_path / "tank.zip").keys()
    assert sum(name.startswith("data/") for name in names) == 2 and any(name.endswith("observer.py") for name in names)
    refused = cli("verify", file, "-j", 1)
    assert refused.exit_code == 2
    assert f"to let them run: rmpc-bench verify {file} --allow-code {file}\n" in refused.stderr
    assert cli("verify", tmp_path / "tank.zip", "--no-run").exit_code == 0
    found = cli("verify", tmp_path / "tank.zip", "-j", 1, "--allow-code", tmp_path / "tank.zip")
    assert found.exit_code == 0, found.output
    assert "code  code/" in found.stderr and "reproduced   all 2 runs, 3 methods" in found.stdout


def test_the_usual_name_of_an_archive(here, tmp_path, monkeypatch):
    """That of the directory, in the current one."""
    monkeypatch.chdir(tmp_path)
    done = cli("pack", here / "out")
    assert done.exit_code == 0 and done.stdout.endswith("rmpc-bench verify out.zip\n")
    assert [path.name for path in tmp_path.iterdir()] == ["out.zip"]


def test_a_directory_that_does_not_fit_is_not_packed(here, tmp_path):
    out = shutil.copytree(here / "out", tmp_path / "out")
    (out / "trials.csv").write_text("method,run\n", encoding="utf-8")
    found = cli("pack", out, "-o", tmp_path / "x.zip")
    assert found.exit_code == 2 and "trials.csv differs from the stored trials; `rmpc-bench report" in found.stderr
    assert cli("report", out).exit_code == 0 and cli("pack", out, "-o", tmp_path / "x.zip").exit_code == 0
    (out / "claims.md").unlink()
    (out / "claims.md").symlink_to("/etc/hostname")
    found = cli("pack", out, "-o", tmp_path / "y.zip")
    assert found.exit_code == 2 and "claims.md: is no regular file" in found.stderr
    assert not (tmp_path / "y.zip").exists()
    assert cli("pack", tmp_path, "-o", tmp_path / "z.zip").exit_code == 2


def test_rows_that_the_report_leaves_out_are_packed(here, tmp_path, monkeypatch):
    """A large experiment has no trials.csv unless it is asked for; pack, verify and compare do without it."""
    monkeypatch.setattr("rmpc_bench.config.report.MOST_ROWS", 20)
    out, rows = shutil.copytree(here / "out", tmp_path / "out"), (here / "out" / "trials.csv").read_bytes()
    left = cli("report", out)
    line = "trials.csv, with 24 rows, is left out; --trials or `report: {trials: true}` writes it"
    assert left.exit_code == 0 and line in left.stderr
    assert not (out / "trials.csv").exists() and "trials.csv" not in (out / "report.html").read_text()
    assert cli("compare", here / "out", out).exit_code == 0
    assert cli("pack", out, "-o", tmp_path / "x.zip").exit_code == 0
    assert packed.contents(tmp_path / "x.zip")["trials.csv"] == rows
    for options in (("-j", 1), ("-j", 1, "--runs", 4), ("--no-run",)):
        found = cli("verify", tmp_path / "x.zip", *options)
        assert found.exit_code == 0, found.output
    asked = cli("report", out, "--trials")
    assert asked.exit_code == 0 and line not in asked.stderr and (out / "trials.csv").read_bytes() == rows
    assert cli("report", out, "--no-trials").exit_code == 0 and not (out / "trials.csv").exists()
    text = (out / "summary.csv").read_text()
    (out / "summary.csv").write_text(text.replace("mse", "mae", 1))
    stale = cli("pack", out, "-o", tmp_path / "y.zip")
    assert stale.exit_code == 2 and "summary.csv differs from the stored trials" in stale.stderr


def test_what_is_no_archive_is_said(tmp_path):
    path = tmp_path / "x.zip"
    path.write_text("no archive", encoding="utf-8")
    found = cli("verify", path)
    assert found.exit_code == 2 and "is not a zip archive" in found.stderr
    assert cli("verify", path, "--no-run", "--runs", 3).exit_code == 2


@pytest.mark.parametrize("options", [[], ["--claim", "better"], ["--runs", 8]])
def test_results_of_a_stopping_rule_are_reproduced(tmp_path, options):
    """Their number of runs and the level of their intervals are those that the rule has chosen."""
    stop = "{decide: claims, min_runs: 6, max_runs: 24}"
    path = write(tmp_path, time=TIME, claims=CLAIMS, paper="zenere2018", stop=stop)
    run = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none")
    assert run.exit_code in (0, 4) and "98.3333 %" in run.stdout, run.output
    assert cli("pack", tmp_path / "out", "-o", tmp_path / "tiny.zip").exit_code == 0
    done = cli("verify", tmp_path / "tiny.zip", "-j", 1, *options)
    assert done.exit_code == 0, done.output


def test_a_configuration_that_does_not_load_is_named_with_its_archive(here, tmp_path):
    """Not with the directory into which it was taken out, which is gone."""
    text = packed.contents(here / "tiny.zip")["config.resolved.yaml"].replace(b"kind: robust-kalman", b"kind: nothing")
    file = forged_packs.archive_with(here / "tiny.zip", tmp_path / "x.zip", {"config.resolved.yaml": text})
    result = cli("verify", file, "-j", 1)
    assert result.exit_code == 2 and f"{file}: config.resolved.yaml:" in result.stderr
    assert "packed/" not in result.stderr


def test_an_outcome_that_cannot_be_noted_is_shown(here, tmp_path, monkeypatch):
    """What was computed is not lost with the record in the archive."""
    file = shutil.copy(here / "tiny.zip", tmp_path / "x.zip")

    def refused(*given):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("rmpc_bench.packing.verify.note_verification", refused)
    result = cli("verify", file, "-j", 1, "--runs", 2)
    assert result.exit_code == 0 and "does not record this outcome: Permission denied" in result.stdout


def test_a_pipe_in_place_of_a_table_ends_pack(here, tmp_path):
    out = shutil.copytree(here / "out", tmp_path / "out")
    (out / "trials.csv").unlink()
    os.mkfifo(out / "trials.csv")
    result = cli("pack", out, "-o", tmp_path / "x.zip")
    assert result.exit_code == 2 and "trials.csv" in result.stderr


def test_statements_of_claims_that_are_given_twice(here, tmp_path):
    """The last one would hide the first."""
    data = json.loads(packed.contents(here / "tiny.zip")["claims.json"])
    data["claims"].insert(0, data["claims"][0] | {"finding": "not confirmed"})
    file = forged_packs.archive_with(here / "tiny.zip", tmp_path / "x.zip", {"claims.json": json.dumps(data).encode()})
    result = cli("verify", file, "-j", 1, "--claim", "better")
    assert result.exit_code == 1 and "is given 2 times" in result.stdout


def test_files_behind_a_link_are_neither_packed_nor_shown(here, tmp_path):
    """A directory of somebody else may have links to private files."""
    (tmp_path / "private").write_text("secret: 1\n", encoding="utf-8")
    out = shutil.copytree(here / "out", tmp_path / "out")
    (out / "config.resolved.yaml").unlink()
    (out / "config.resolved.yaml").symlink_to(tmp_path / "private")
    assert cli("report", out, "--to", tmp_path / "to").exit_code == 0
    assert "secret" not in (tmp_path / "to" / "report.html").read_text(encoding="utf-8")
    (tmp_path / "tuning").mkdir()
    (tmp_path / "tuning" / "seconds.json").write_text("{}", encoding="utf-8")
    out = shutil.copytree(here / "out", tmp_path / "other")
    (out / "tuning").symlink_to(tmp_path / "tuning")
    found = cli("pack", out, "-o", tmp_path / "x.zip")
    assert found.exit_code == 2 and "through a symbolic link" in found.stderr
