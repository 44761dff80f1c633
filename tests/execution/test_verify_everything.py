"""`verify` against forged archives: whatever file is altered, no word of the outcome says that it was compared."""

import json
from pathlib import Path

import packed
import pytest
from execution.test_own_experiment import written
from forged_packs import METADATA, archive_with, forged
from own_experiment import write_own
from small_experiment import cli, write

import rmpc_bench
from rmpc_bench.received.archive import ArchiveError
from rmpc_bench.types import ConfigError

CONFIGS = Path(__file__).parents[2] / "configs"
CLAIMS = """
  - {id: better, says: R-MPC wins, source: s, check: 'mean(mse[R-MPC]) < mean(mse[S-MPC])', finding: confirmed}
"""
INPUTS = ("config.yaml", "config.resolved.yaml", "manifest.json", METADATA)
COMPARED = ("compared, equal bytes", "compared, equal to 1e-9")
PAPERS = {
    "zenere2018": "zenere2018/fig7",
    "souto2011": "souto2011/fig2",
    "ma2025": "ma2025/table1",
    "belda2017": "belda2017/exp1",
    "wkf2018": "wkf2018/fig5",
}
"""A configuration of every paper."""


def packed_results(path, directory, *options):
    """Compute an experiment with its report and pack it."""
    done = cli("run", path, "-o", directory / "out", "-j", 1, "--progress", "none", *options)
    assert done.exit_code in (0, 4), done.output
    done = cli("pack", directory / "out", "-o", directory / "honest.zip", "--author", "A. Author")
    assert done.exit_code == 0, done.output
    return directory / "honest.zip"


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """An archive with claims, a figure, recorded runs, uncertain quantities and series."""
    place = tmp_path_factory.mktemp("small")
    keys = {"claims": CLAIMS, "paper": "zenere2018", "figures": "[boxplot]", "record": "{runs: 2, signals: [y, u]}"}
    path = write(place, runs=6, metrics="[mse, input_power, settling_time]", **keys)
    return packed_results(path, place)


def words(path, **options):
    """Verify an archive; return the result and file -> word."""
    found = rmpc_bench.verify(path, jobs=1, allow_code=[path], **options)
    return found, {each.name: each.word for each in found.files}


def derived(path):
    """Name the files that are not input."""
    # Without a column that has its name trials.csv is refused at once.
    inputs = (*INPUTS, "verified_on.json", "timings.csv", "trials.csv")
    return [name for name in packed.contents(path) if name not in inputs and not name.startswith(("code/", "data/"))]


def not_passed(archive, to, kind, seed=0):
    """Alter every file and assert that none of them is called compared: derived ones at once, inputs one by one."""
    content = packed.contents(archive)
    changes = {name: forged(content[name], name, kind, seed) for name in derived(archive)}
    changes = {name: change for name, change in changes.items() if change is not None}
    found, outcome = words(archive_with(archive, to, changes))
    assert not found.reproduced and changes
    assert {name: outcome[name] for name in changes if outcome[name] != "different"} == {}
    altered = [name for name in content if name not in changes and name != "verified_on.json"]
    for name in altered:
        change = forged(content[name], name, kind, seed)
        if change is None:
            continue
        try:
            found, outcome = words(archive_with(archive, to, {name: change}))
        except (ConfigError, ArchiveError):
            continue
        assert outcome[name] in ("different", "only hashed"), name
        assert not found.reproduced or name not in INPUTS[1:2], name


@pytest.mark.parametrize(
    "kind", ["either", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("digit", "word"))]
)
def test_no_forged_file_is_called_compared(small, tmp_path, kind):
    not_passed(small, tmp_path / "bad.zip", kind)


def test_an_honest_archive_names_what_was_not_compared(small, tmp_path):
    path = archive_with(small, tmp_path / "copy.zip", {METADATA: packed.contents(small)[METADATA]})
    done = cli("verify", path, "-j", 1)
    assert done.exit_code == 0 and "reproduced   all 6 runs, 2 methods" in done.stdout, done.output
    names = packed.contents(path)
    assert f"{len(names)} files: {len(names) - 4} compared, equal bytes" in done.stdout
    for text in ("only hashed\n", "  config.yaml   input: resolves to", "not looked at\n  verified_on.json"):
        assert text in done.stdout, done.stdout
    (record,) = json.loads(names["verified_on.json"])
    assert record["files"].keys() == names.keys() and record["files"]["report.html"] == COMPARED[0]


def on_another_machine(content):
    """A manifest of another machine, or with another version of the bench."""
    data = json.loads(content)
    data["platform"]["machine"] = "other"
    return json.dumps(data).encode()


def test_another_machine_may_differ_in_the_last_digits_only(small, tmp_path):
    """Tables are then made from the packed rows; what differs above the ninth digit is found there, too."""
    content = packed.contents(small)
    manifest = {"manifest.json": on_another_machine(content["manifest.json"])}
    found, outcome = words(archive_with(small, tmp_path / "other.zip", manifest))
    assert found.reproduced and outcome["trials.csv"] == COMPARED[1] and outcome["report.html"] == COMPARED[0]
    lines = content["uncertainty.csv"].decode().splitlines()
    value = lines[1].split(",")[1]
    near = content["uncertainty.csv"].replace(value.encode(), repr(float(value) * (1 + 1e-12)).encode())
    found, outcome = words(archive_with(small, tmp_path / "near.zip", {**manifest, "uncertainty.csv": near}))
    assert found.reproduced and outcome["uncertainty.csv"] == COMPARED[1]
    changes = {name: forged(content[name], name, "digit") for name in derived(small)}
    changes = {name: change for name, change in changes.items() if change is not None}
    found, outcome = words(archive_with(small, tmp_path / "bad.zip", {**manifest, **changes}))
    passed = {name for name in changes if outcome[name] in COMPARED}
    assert not found.reproduced and passed == set()


def test_pages_of_another_version_are_named_and_not_compared(small, tmp_path):
    content = packed.contents(small)
    data = json.loads(content["manifest.json"])
    data["versions"]["rmpc-bench"] = "0.0.9"
    changes = {"manifest.json": json.dumps(data).encode(), "report.html": content["report.html"] + b"<!-- -->"}
    found, outcome = words(archive_with(small, tmp_path / "old.zip", changes))
    assert outcome["report.html"] == "not compared, made by rmpc-bench 0.0.9"
    assert "not compared, made by rmpc-bench 0.0.9\n  report.html" in str(found)


@pytest.mark.parametrize("options", [{"runs": 2}, {"simulate": False}])
def test_empty_and_binary_tables_are_found_without_all_runs(small, tmp_path, options):
    path = archive_with(small, tmp_path / "bad.zip", {"summary.csv": b"", "comparisons.csv": b"\0\xff"})
    assert not words(path, **options)[0].reproduced


def test_part_of_the_runs_says_how_little_that_is(small, tmp_path):
    """A row that was not computed again passes, and the text says so."""
    content = packed.contents(small)
    done = cli("verify", archive_with(small, tmp_path / "copy.zip", {}), "--runs", 2, "-j", 1)
    assert "4 of 6 runs were not computed, their rows are taken as packed" in done.stdout, done.output
    assert "  trials.csv   rows of runs 0 to 1 are compared" in done.stdout
    assert "  report.html   needs all runs" in done.stdout
    changes = {name: forged(content[name], name, "digit") for name in ("tables/mse.tex", "claims.json", "summary.csv")}
    _, outcome = words(archive_with(small, tmp_path / "bad.zip", changes), runs=2)
    assert {outcome[name] for name in changes} == {"different"}


def test_files_that_are_missing_or_added(small, tmp_path):
    content = packed.contents(small)
    metadata = json.loads(content.pop(METADATA))
    gone = "tables/mse.tex"
    del content[gone]
    metadata["@graph"] = [each for each in metadata["@graph"] if each["@id"] != gone]
    path = packed.write(tmp_path / "bad.zip", content | {METADATA: json.dumps(metadata).encode()})
    found, outcome = words(path)
    assert outcome[gone] == "different" and f"{gone}: is missing" in str(found)


def test_the_report_is_made_with_the_options_that_made_it(tmp_path):
    """Width, order and formats of `report`, and a directory below `results`."""
    path = write(tmp_path, runs=4, figures="[boxplot]")
    out = tmp_path / "results" / "mine"
    assert cli("run", path, "-o", out, "-j", 1, "--progress", "none").exit_code == 0
    options = ["--width", "88mm", "--order", "R-MPC,S-MPC", "--format", "svg", "--style", "paper"]
    assert cli("report", out, *options).exit_code == 0
    assert cli("pack", out, "-o", tmp_path / "x.zip").exit_code == 0
    found, outcome = words(tmp_path / "x.zip")
    assert found.reproduced, found
    # Files of the first report, which the second one does not make.
    assert outcome["figures/boxplot.png"] == "not looked at" and outcome["figures/boxplot.svg"] == COMPARED[0]


@pytest.mark.parametrize("keys", [{"format": ["pgf", "svg"]}, {"order": 5}, ["x"]])
def test_what_the_manifest_asks_of_the_report_runs_no_latex(small, tmp_path, monkeypatch, keys):
    """LaTeX reads and writes files; wrong keys are refused."""

    def refuse():
        raise AssertionError("LaTeX was called")

    monkeypatch.setattr("rmpc_bench.figures.files.as_latex", refuse)
    data = json.loads(packed.contents(small)["manifest.json"])
    data["report"]["keys"] = keys
    path = archive_with(small, tmp_path / "bad.zip", {"manifest.json": json.dumps(data).encode()})
    found = cli("verify", path, "-j", 1)
    expected = found.exit_code == 1 if "format" in keys else f"{path}: manifest.json: report" in found.stderr
    assert expected and found.exit_code in (1, 2), found.output


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize("paper", PAPERS)
def test_every_paper_at_smoke_size_is_reproduced(tmp_path, paper, jobs):
    archive = packed_results(CONFIGS / f"{PAPERS[paper]}.yaml", tmp_path, "--smoke")
    done = cli("verify", archive, "-j", jobs)
    assert done.exit_code == 0 and "reproduced" in done.stdout, done.output


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two-tanks", "pendulum"])
def test_examples_with_own_components_are_reproduced(tmp_path, name):
    archive = packed_results(CONFIGS / "examples" / f"{name}.yaml", tmp_path, "--smoke")
    for jobs in (1, 2):
        done = cli("verify", archive, "-j", jobs, "--allow-code", archive)
        assert done.exit_code == 0 and "reproduced" in done.stdout, done.output


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["digit", "word"])
@pytest.mark.parametrize("name", ["quickstart", "fig7", "own", "tank"])
def test_no_forged_file_of_larger_archives_is_called_compared(tmp_path, name, kind):
    """With failed, held and warning runs (own), and with data files (tank)."""
    made = {
        "quickstart": lambda: packed_results(CONFIGS / "quickstart.yaml", tmp_path, "--runs", 4),
        "fig7": lambda: packed_results(CONFIGS / "zenere2018" / "fig7.yaml", tmp_path, "--smoke"),
        "own": lambda: packed_results(write_own(tmp_path), tmp_path),
        "tank": lambda: packed_results(written(tmp_path), tmp_path),
    }
    not_passed(made[name](), tmp_path / "bad.zip", kind)
