"""Every configuration at full size: its recorded findings are found again, its kept results are what is written."""

import itertools
import json
import re
import subprocess
from pathlib import Path

import pytest

from rmpc_bench import publish
from rmpc_bench.claims.verdict import judge

ROOT = Path(__file__).parents[2]
CONFIGS = sorted(f"{path.parent.name}/{path.stem}" for path in (ROOT / "configs").glob("*/*.yaml"))
QUICK = (
    "benchmarks/f404",
    "benchmarks/kothare1996",
    "benchmarks/sayed2001",
    "benchmarks/simon-motor",
    "estimators/bounds",
    "mayne2005/tube",
    "souto2011/alpha",
    "souto2011/benchmarks",
    "souto2011/guarantee",
    "souto2011/table",
    "zenere2018/interpretations-sim1",
)
"""Configurations that take less than 5 s; the default tests compute them, too."""


def kept_files(name):
    """Return the files below results/ that are kept of a configuration, relative to its directory."""
    directory = ROOT / "results" / name
    listed = subprocess.run(["git", "ls-files", "."], cwd=directory, capture_output=True, text=True, check=False)
    return [directory / file for file in listed.stdout.split()]


def of_all(names, quick):
    """Return the names as parameters; all but the quick ones are slow tests."""
    return [pytest.param(name, marks=[] if name in quick else pytest.mark.slow) for name in names]


def same_but_for_rounding(kept, written):
    """Whether two files differ in margins only, and those of claims.json by less than the sixth digit of a side.

    Sums of another processor are rounded in another way.  A difference of sides keeps their error, but not their size.
    """
    one, other = (path.read_text("utf-8") for path in (kept, written))
    if kept.name != "claims.json":
        return re.sub(r"margins of \S+", "", one) == re.sub(r"margins of \S+", "", other)
    claims, found = json.loads(one), json.loads(other)
    checks, now = ([part for claim in each["claims"] for part in claim["numbers"]] for each in (claims, found))
    for old, new in zip(checks, now, strict=False):
        for end in ("low", "high") if old["change"] and new["change"] else ():
            size = 1e-6 * max(abs(old["left"]), abs(old["right"]))
            if new["change"][end] == pytest.approx(old["change"][end], rel=0, abs=size):
                new["change"][end] = old["change"][end]
    return claims == found


@pytest.mark.parametrize("name", of_all(CONFIGS, QUICK))
def test_every_finding_is_the_recorded_one(trials_of, name):
    """What the configuration records is what its trials and moments say."""
    config, trials = trials_of(name)
    found = {claim.says: (judge(claim, trials).finding, claim.finding) for claim in config.claims}
    assert {says: now for says, (now, _) in found.items()} == {says: recorded for says, (_, recorded) in found.items()}
    assert (trials.frame["status"] != "ok").sum() <= config.execution.max_failures


@pytest.mark.parametrize("name", of_all((n for n in CONFIGS if (ROOT / "results" / n).is_dir()), QUICK))
def test_kept_results_are_what_is_written(results_of, name):
    """Every file that is kept has the bytes that the present code writes, up to the rounding of differences."""
    kept = kept_files(name)
    if not kept:
        pytest.skip("nothing of it is kept, or this is no clone")
    _, results = results_of(name)
    directory = publish(results, place=f"results/{name}").directory
    for path in kept:
        written = directory / path.relative_to(ROOT / "results" / name)
        assert written.exists(), f"{path.relative_to(ROOT)} is no longer written"
        if written.read_bytes() != path.read_bytes() and not same_but_for_rounding(path, written):
            pairs = itertools.zip_longest(*(each.read_text("utf-8").splitlines() for each in (path, written)))
            changed = [f"kept    {old}\nwritten {new}" for old, new in pairs if old != new]
            pytest.fail(
                f"{path.relative_to(ROOT)} is stale: rmpc-bench run configs/{name}.yaml\n" + "\n".join(changed[:3])
            )
