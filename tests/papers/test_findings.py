"""Every configuration of a paper, and every benchmark system, at full size: each recorded finding is found again."""

from pathlib import Path

import pytest

from rmpc_bench.claims.verdict import judge

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2] / "configs"
CONFIGS = sorted(f"{path.parent.name}/{path.stem}" for path in ROOT.glob("*/*.yaml"))


@pytest.mark.parametrize("name", CONFIGS)
def test_every_finding_is_the_recorded_one(trials_of, name):
    """What the configuration records is what its trials and moments say."""
    config, trials = trials_of(name)
    found = {claim.says: (judge(claim, trials).finding, claim.finding) for claim in config.claims}
    assert {says: now for says, (now, _) in found.items()} == {says: recorded for says, (_, recorded) in found.items()}
    assert (trials.frame["status"] != "ok").sum() <= config.execution.max_failures
