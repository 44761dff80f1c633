"""docs/cluster.md, followed literally; the scheduler's variables are set by stand-ins for its commands."""

from pathlib import Path

import pytest
from docs.batch_systems import write_commands
from docs.followed_page import BLOCK, follow

PAGE = Path(__file__).parents[2] / "docs" / "cluster.md"
DIRECTORIES = ("study", "pbs", "sge", "dask")
"""Results of the ways of the page."""


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """Run every command of the page; the directory and what was printed."""
    place, commands = tmp_path_factory.mktemp("page"), tmp_path_factory.mktemp("commands")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in write_commands(commands).items():
            patch.setenv(name, value)
        return place, {step.line: step for step in follow(PAGE, place)}


@pytest.mark.page("cluster")
def test_every_command_works(followed):
    _, steps = followed
    assert len(steps) == 12
    for line, step in steps.items():
        assert step.code == 0, f"{line}\n{step.out}{step.err}"
        assert "Traceback" not in step.err, f"{line}\n{step.err}"


@pytest.mark.page("cluster")
def test_all_ways_give_the_same_bytes(followed):
    place, _ = followed
    found = {name: (place / "results" / name / "trials.csv").read_bytes() for name in DIRECTORIES}
    assert len(set(found.values())) == 1 and found["study"].count(b"\n") == 401


@pytest.mark.page("cluster")
def test_what_status_and_merge_show(followed):
    """The text of the page about them is true."""
    _, steps = followed
    status = steps["rmpc-bench status results/study"].out
    assert "study   400 of 400 trials (100 %), 0 failed" in status
    assert all(f"{number}-of-4" in status for number in range(1, 5))
    assert "200 of 200 runs, 0 failed" in steps["rmpc-bench merge results/study"].out
    assert "200 of 200 runs, 0 failed" in steps["rmpc-bench run study.yaml --missing"].out
    # The directory has all runs when the shard is computed again.
    assert "100 of 100 trials" in steps["rmpc-bench run study.yaml --shard 3/4"].out


def test_the_scripts_have_the_directives_of_their_schedulers():
    scripts = {name: text for language, name, text in BLOCK.findall(PAGE.read_text(encoding="utf-8")) if name}
    for name, marks in {
        "study.slurm": ["#SBATCH --array="],
        "study.pbs": ["#PBS -J "],
        "study.sge": ["#$ -t "],
    }.items():
        assert all(mark in scripts[name] for mark in marks)
        assert "--shard auto" in scripts[name] and scripts[name].startswith("#!/bin/bash\n")
