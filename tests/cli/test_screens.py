"""The texts of the verbs in a terminal: never wider than it, the answer in the first five lines, few lines."""

import json

import pytest
from small_experiment import cli, write

from rmpc_bench.types.texts import width_of

LONG = "a-method-whose-name-has-sixty-characters-as-in-no-other-papers"
TWO = "{S-MPC: {estimator: {kind: kalman}}, R-MPC: {estimator: {kind: robust-kalman, c: 0.1}}}"
CASES = {
    "two methods": {},
    "long names": {"methods": TWO.replace("R-MPC", LONG)},
    "per cent": {"methods": TWO.replace("R-MPC", '"100 % <b>"')},
    "six methods": {
        "methods": str({f"M{k}": {"estimator": {"kind": "robust-kalman", "c": (k + 1) / 10}} for k in range(6)})
    },
    "a number": {"sweep": "{grid: {plant.J_l: [20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75]}}"},
    "names": {"sweep": "{zip: [{name: the nominal plant, plant.J_l: 25}, {name: a heavy one, plant.J_l: 50}]}"},
    "two paths": {"sweep": "{grid: {plant.J_l: [20, 30, 40], controller.Hp: [10, 12]}}"},
    "failures": {"uncertainty": "{eps: +-150%}", "execution": "{max_failures: 100}"},
    "claims": {"claims": "[{says: R-MPC wins, source: s, check: 'mean(mse[R-MPC]) < 0', finding: confirmed}]"},
    "an event": {"metrics": "[settling_time, mse]"},
}


def lines_of(result, width, *, most=1000):
    """Return the lines of a command that has worked."""
    assert result.exit_code in (0, 1), result.output
    lines = result.stdout.splitlines()
    assert max(map(width_of, lines)) <= width, "\n".join(line for line in lines if width_of(line) > width)
    assert len(lines) <= most, result.stdout
    assert "nan" not in result.stdout and "\x1b" not in result.stdout
    return lines


@pytest.mark.parametrize("case", CASES)
def test_no_line_is_wider_than_the_terminal(tmp_path, monkeypatch, case):
    monkeypatch.chdir(tmp_path)
    keys = {"runs": 4, "time": "{step: 0.1, steps: 6}", **CASES[case]}
    if "sweep" in keys:
        keys["uncertainty"] = keys["plant"] = None
        keys["plant"] = "{kind: servo-linear}"
        keys["noise"] = "same"
    write(tmp_path, **keys)
    run = lines_of(cli("run", "tiny.yaml", "-o", "out", "-j", 1, "--progress", "none"), 80, most=25)
    assert lines_of(cli("run", "tiny.yaml", "-o", "out", "-j", 1), 80)[1:] == run[1:]
    assert len(lines_of(cli("check", "tiny.yaml"), 80)) <= 40
    assert json.loads(cli("status", "out", "--json").stdout)["name"] == "tiny"
    monkeypatch.setenv("COLUMNS", "60")
    narrow = lines_of(cli("report", "out"), 60, most=25)
    for shown in (run, narrow):
        assert next(k for k, line in enumerate(shown) if k and line and not line.startswith(" ")) <= 4
        assert shown[-1] == " out/report.html"
    lines_of(cli("check", "tiny.yaml", "--full"), 60)
    lines_of(cli("compare", "out", "out", "--values"), 60)
    lines_of(cli("describe", "tiny.yaml"), 60)
    lines_of(cli("status", "out"), 60)


@pytest.mark.parametrize("name", ["estimators/robust-kalman", "plants/servo", "controllers/mpc", "noises/uniform"])
def test_manuals_are_folded(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = cli("describe", name).stdout.partition("\nExamples\n")[0]
    assert max(map(width_of, text.splitlines())) <= 80


def test_a_smoke_run_says_what_ran(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, smoke="{runs: 2, steps: 5}")
    lines = lines_of(cli("run", "tiny.yaml", "--smoke", "-j", 1, "--progress", "none"), 80, most=12)
    assert lines[0].startswith("tiny   smoke run: 2 of 2 runs, 0 failed")
    assert [line.split() for line in lines if line.startswith((" S-", " R-"))] == [["S-MPC", "ran"], ["R-MPC", "ran"]]


def test_a_name_that_turns_the_direction_of_writing_is_refused(tmp_path):
    path = write(tmp_path, methods=TWO.replace("R-MPC", '"R\\u202EMPC"'))
    result = cli("run", path, "-o", tmp_path / "out")
    assert result.exit_code == 2 and "U+202E" in result.stderr


def test_a_refused_directory_names_few_settings(tmp_path):
    """A sweep is one line."""
    sweep = "{grid: {plant.J_l: [%s]}}"
    keys = {"runs": 2, "plant": "{kind: servo-linear}", "uncertainty": None, "noise": "same"}
    path = write(tmp_path, sweep=sweep % "20, 21, 22, 23, 24, 25, 26", **keys)
    assert cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none").exit_code == 0
    path = write(tmp_path, sweep=sweep % "30, 31, 32, 33, 34, 35", **keys)
    refused = cli("run", path, "-o", tmp_path / "out", "-j", 1)
    lines = refused.stderr.splitlines()
    assert refused.exit_code == 5 and lines[0].endswith("holds another experiment:") and len(lines) <= 8
    assert sum("sweep" in line for line in lines) == 1
