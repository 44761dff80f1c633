"""README.md: the four results are those of the kept results, and the words beside the first example are measured."""

import json
import re
import shlex
import shutil

import forked_commands
import pandas as pd
from docs.followed_page import README, followed
from docs.markdown import ROOT

TEXT = README.read_text(encoding="utf-8")
WORDS = " ".join(TEXT.split())
RESULTS = {
    match[3]: match[2]
    for match in re.finditer(r"^\| (.+) \| (.+) \| `rmpc-bench run configs/(\S+)\.yaml` \|$", TEXT, re.MULTILINE)
}
"""Configuration -> the cell with its numbers."""


def comparisons(name):
    """Text of a comparison and its point -> its two sides, from the kept claims of a configuration."""
    claims = json.loads((ROOT / "results" / name / "claims.json").read_text(encoding="utf-8"))
    command = f"rmpc-bench run configs/{name}.yaml"
    assert claims["experiment"]["command"] == command and f"`{command}`" in TEXT
    return {(each["text"], each["at"]): each for claim in claims["claims"] for each in claim["numbers"]}


def test_four_results_have_a_line():
    assert [*RESULTS] == ["zenere2018/rivals", "souto2011/guarantee", "ma2025/certificate", "servo-constrained/penalty"]


def test_rivals():
    found = comparisons("zenere2018/rivals")
    sides = [found[f"mean(mse[{name}]) < mean(mse[R-tuned])", None] for name in ("S-process", "S-input", "S-load")]
    assert all(each["holds"] for each in sides)
    low, high = min(each["left"] for each in sides), max(each["left"] for each in sides)
    stated = f"{low:.4f} to {high:.4f} against {sides[0]['right']:.4f} rad^2; {sides[0]['n']} plants"
    assert stated in RESULTS["zenere2018/rivals"]


def test_guarantee():
    found, cell = comparisons("souto2011/guarantee"), RESULTS["souto2011/guarantee"]
    bound = "all(since(excess(cov(e[ERP]), P[ERP]), 1) <= 1.000000001)"
    fixed, worst = found[bound, "F = 1"], found[bound, "adversary"]
    assert not fixed["holds"] and not worst["holds"] and worst["k"] == fixed["k"] == 120
    assert f"{fixed['left']:.1f} times at k = {fixed['k']}; {worst['left']:.0f} times with the worst F" in cell
    (start,) = (text for text, _ in found if text.startswith("all(since(excess(cov(e[ERP]), P[ERP]), 16) > 1"))
    assert found[start, None]["holds"] and "from k = 16 on" in cell


def test_certificate():
    side = comparisons("ma2025/certificate")["mean(at_20[RCMIX]) <= 1", None]
    assert not side["holds"] and f"{side['left']:.1f} times as much (N = 100, k = 20)" in RESULTS["ma2025/certificate"]


def test_penalty():
    comparisons("servo-constrained/penalty")
    kept = pd.read_csv(ROOT / "results" / "servo-constrained" / "penalty" / "summary.csv")
    rows = kept[kept.metric == "runaway"].set_index(["method", "controller.soft.shaft_torque.linear"])
    counts = (rows["mean"] * rows.n).round()
    assert {*counts["S"][counts["S"].index >= 0.02]} == {30} and {*rows.n} == {200}
    assert not counts["S"][counts["S"].index <= 0.003].any() and not counts["S+input"].any()
    stated = "30 of 200 runs with penalties from 0.02 on, 0 up to 0.003; 0 with an input disturbance"
    assert stated in RESULTS["servo-constrained/penalty"]


def printed(out, method):
    """Cells of a method in the table that a run prints, without the time per step."""
    (line,) = (line for line in out.splitlines() if line.split()[:1] == [method] and "[" in line)
    cells = re.split(r"\s{2,}", line.strip())
    return [cell for cell in cells if not re.fullmatch(r"[\d.]+ (us|ms)", cell)]


def test_the_row_of_the_own_estimator():
    """What its command prints, without the time per step, which differs from machine to machine."""
    _, added = (step for step in followed(README).steps if " run " in step.line)
    (row,) = (line for line in TEXT.splitlines() if line.startswith("| mine |"))
    assert [cell.strip() for cell in row.strip("|").split("|")] == printed(added.out, "mine")
    option, change = re.search(r"with `(.*?)` it is (\S+ % \[.*?\]) better than R-MPC", WORDS).groups()
    place = followed(README).place
    # The same trials are in the other directory already.
    shutil.copytree(place / "results" / "servo", place / "other")
    again = [*shlex.split(added.line)[1:], *shlex.split(option), "-o", "other", "--progress", "none"]
    done = forked_commands.run(again, place)
    assert done.returncode == 0, done.stderr
    found = printed(done.stdout, "mine")[2]
    ends = [each.strip("-+") for each in re.findall(r"[-+]?[\d.]+", found)]
    assert [ends[0], *sorted(ends[1:])] == re.findall(r"[\d.]+", change) and found.startswith("-")


def test_the_first_example_draws_two_parameters_and_no_noise(tmp_path):
    """With the noise of the design model the order of the methods is the other one."""
    (tmp_path / "servo.yaml").write_bytes((followed(README).place / "servo.yaml").read_bytes())
    done = forked_commands.run(["run", "servo.yaml", "-s", "noise=same", "--progress", "none"], tmp_path)
    assert done.returncode == 0, done.stderr
    change = printed(done.stdout, "R-MPC")[2].split(" [")[0]
    assert f"With `noise: same` it is that of the design model, and R-MPC is {change.lstrip('+')} worse." in WORDS
    drawn = pd.read_csv(followed(README).place / "results" / "servo" / "uncertainty.csv")
    assert {*drawn.columns} == {"run", "eps", "eps_load"}
    assert "\nnoise:" not in (tmp_path / "servo.yaml").read_text(encoding="utf-8")
