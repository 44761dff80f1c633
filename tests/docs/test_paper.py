"""paper/paper.md: its sections, length and references, and every number against the kept results."""

import json
import re
from collections import Counter

import pandas as pd
import pytest
from docs.followed_page import README
from docs.markdown import ROOT
from docs.reproductions_page import PAPERS

from rmpc_bench import registry

TEXT = (ROOT / "paper" / "paper.md").read_text("utf-8").split("\n---\n", 1)[1]
PROSE = " ".join(re.sub(r"<!--.*?-->", "", TEXT, flags=re.DOTALL).split())
SECTIONS = "Summary,Statement of need,State of the field,Software design,Research impact,AI usage disclosure,References"


def test_the_form_is_that_of_the_journal():
    assert re.findall(r"^# (.*)$", TEXT, re.MULTILINE) == SECTIONS.split(",")
    assert 1000 <= len(PROSE.split()) <= 1500
    entries = re.findall(r"^@\w+\{(\w+),", (ROOT / "paper" / "paper.bib").read_text("utf-8"), re.MULTILINE)
    assert sorted(entries) == sorted({*re.findall(r"@(\w+)", PROSE)}) and "suite-1" not in TEXT


def test_every_command_is_one_of_a_kept_result():
    names = re.findall(r"rmpc-bench run configs/(\S+)\.yaml", TEXT)
    assert len(names) == 4 and all((ROOT / "results" / name / "claims.json").is_file() for name in names)


def test_components():
    """Kinds may have been added later."""
    for group in ("estimators", "controllers", "plants"):
        assert 9 <= int(re.search(rf"(\d+) {group}", PROSE)[1]) <= len(registry.BUILT_IN[group])


@pytest.mark.parametrize(
    ("method", "stated"), [("R-MPC", "is {} % lower"), ("KF-R", "reaches {} %"), ("KF-dist", "reaches {} %")]
)
def test_tuned_alike(method, stated):
    table = pd.read_csv(ROOT / "results" / "estimators" / "friction-tuned" / "comparisons.csv")
    (row,) = table[(table.name == "no noise") & (table.metric == "mse") & (table.method == method)].to_dict("records")
    assert row["baseline"] == "S-MPC" and stated.format(f"{-row['change_pct']:.1f}") in PROSE


def test_speed():
    rows = json.loads((ROOT / "results" / "perf" / "perf.json").read_text("utf-8"))
    wanted = {"servo: Fig. 7, S-MPC": "loop over runs and samples", "filterpy KF": "library"}
    servo, adapter = (row for row in rows if row["beside"].startswith(wanted.get(row["name"], " ")))
    ours, baseline = (servo[side]["seconds"] * 1e6 for side in ("ours", "baseline"))
    assert f"takes {ours:.3g} us" in PROSE and f"takes {baseline:.3g} us" in PROSE
    assert f"difference of {servo['difference']:.0e}" in PROSE
    assert f"{100 * (adapter['ours']['seconds'] / adapter['baseline']['seconds'] - 1):.0f} % more" in PROSE


def test_an_adjusted_interval_is_that_of_the_readme():
    factor = re.search(r"\(quadratic\): (\S+) times narrower", README.read_text("utf-8"))[1]
    assert f"{factor} times narrower" in PROSE


def test_findings():
    records = [json.loads(path.read_text("utf-8")) for path in (ROOT / "results").glob("*/*/claims.json")]
    claims = [(record["experiment"]["paper"], each) for record in records for each in record["claims"]]
    stated = [pair for pair in claims if pair[0] in PAPERS and pair[1]["kind"] == "statement of the paper"]
    found = {(paper, each["id"] or each["statement"]): each["joined"] or each["finding"] for paper, each in stated}
    counts = Counter(found.values())
    confirmed, depends, not_confirmed, untested = (
        counts[name] for name in ("confirmed", "depends-on-assumptions", "not-confirmed", "not-testable")
    )
    rest = counts.total() - confirmed - depends - not_confirmed - untested
    assert f"contain {counts.total()} statements that we could write down. {confirmed} of them are confirmed." in PROSE
    assert f"{depends} depend on assumptions" in PROSE and f"The remaining {rest} are" in PROSE
    assert f"{not_confirmed} are not confirmed, and {untested} cannot be tested" in PROSE


def test_three_results_are_those_of_the_readme():
    """tests/docs/test_readme.py compares these with the kept results."""
    readme = README.read_text("utf-8")
    for number in ("0.0981 to 0.0996 against 0.1043 rad^2", "5.0 times", "65.5 times as much"):
        assert number in readme and number in PROSE
