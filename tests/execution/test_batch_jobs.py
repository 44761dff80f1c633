"""The shard of a task of an array job, with the variables of SLURM, PBS and SGE."""

import sys

import pytest
from small_experiment import cli, write

from rmpc_bench.execution.shards import ArrayJobError, n_cores, shard_of_array_job


def slurm(index, first, last, step=1, count=None):
    """Return what SLURM sets."""
    numbers = {"ID": index, "MIN": first, "MAX": last, "STEP": step, "COUNT": count or (last - first) // step + 1}
    return {f"SLURM_ARRAY_TASK_{name}": str(number) for name, number in numbers.items()}


def sge(index, first, last, step=1):
    """Return what SGE sets."""
    numbers = {"TASK_ID": index, "TASK_FIRST": first, "TASK_LAST": last, "TASK_STEPSIZE": step}
    return {f"SGE_{name}": str(number) for name, number in numbers.items()}


@pytest.fixture
def qstat(tmp_path, monkeypatch):
    """Return a function that sets what `qstat -f` prints."""
    monkeypatch.setenv("PATH", str(tmp_path))

    def says(text, code=0):
        program = tmp_path / "qstat"
        program.write_text(f"#!{sys.executable}\nimport sys\nprint({text!r}, sys.argv)\nsys.exit({code})\n")
        program.chmod(0o755)

    return says


@pytest.mark.parametrize("first", [0, 1, 5])
@pytest.mark.parametrize("step", [1, 3])
@pytest.mark.parametrize("variables", [slurm, sge])
def test_arrays_with_any_first_index_and_step(first, step, variables):
    last = first + 6 * step
    for position in range(7):
        assert shard_of_array_job(variables(first + position * step, first, last, step)) == (position + 1, 7)


@pytest.mark.parametrize(
    ("text", "index", "expected"),
    [
        ("    array_indices_submitted = 0-6\n", 2, (3, 7)),
        ("    array_indices_submitted = 10-22:3\n", 22, (5, 5)),
        ("    job_array_request = 1-4%2\n", 4, (4, 4)),
        ("    job_array_request = 3\n", 3, (1, 1)),
    ],
)
@pytest.mark.parametrize("name", ["PBS_ARRAY_INDEX", "PBS_ARRAYID"])
def test_arrays_of_pbs(qstat, text, index, expected, name):
    qstat(f"Job Id: 7[].node\n{text}    queue = short\n")
    assert shard_of_array_job({name: str(index), "PBS_JOBID": "7[2].node"}) == expected


def test_pbs_without_qstat(qstat):
    """The message has a command that works."""
    with pytest.raises(ArrayJobError, match=r"`qstat -f 7\[\].node` does not show how many tasks .* give --shard with"):
        shard_of_array_job({"PBS_ARRAY_INDEX": "1", "PBS_ARRAY_ID": "7[].node"})
    qstat("unknown job", code=35)
    with pytest.raises(ArrayJobError, match="does not show how many tasks"):
        shard_of_array_job({"PBS_ARRAY_INDEX": "1", "PBS_ARRAY_ID": "7[].node"})
    qstat("    queue = short\n")
    with pytest.raises(ArrayJobError, match="shows no range of indices"):
        shard_of_array_job({"PBS_ARRAY_INDEX": "1", "PBS_ARRAY_ID": "7[].node"})


def test_a_list_of_pbs_is_no_range(qstat):
    qstat("    job_array_request = 1,4,9\n")
    with pytest.raises(ArrayJobError, match="shows no range"):
        shard_of_array_job({"PBS_ARRAYID": "4", "PBS_JOBID": "7[4].node"})


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({}, "this process is no task of an array job"),
        ({"SGE_TASK_ID": "undefined"}, "this process is no task of an array job"),
        (slurm(3, 1, 9, count=4), "4 of the 9 indices from 1 to 9: --shard auto needs a range without gaps"),
        (slurm(10, 1, 9), "SLURM_ARRAY_TASK_ID is 10, which is not an index of the array 1-9"),
        (slurm(2, 1, 9, step=2), "is not an index of the array 1-9:2"),
        ({"SLURM_ARRAY_TASK_ID": "1"}, "SLURM_ARRAY_TASK_MIN must be a whole number"),
        ({**sge(1, 1, 4), "SGE_TASK_LAST": "x"}, "SGE_TASK_LAST must be a whole number"),
    ],
)
def test_what_is_no_array_job(variables, message):
    with pytest.raises(ArrayJobError, match=message):
        shard_of_array_job(variables)


def test_the_command_line(tmp_path, monkeypatch):
    path = write(tmp_path)
    for name, value in slurm(7, 5, 8).items():
        monkeypatch.setenv(name, value)
    result = cli("run", path, "-o", tmp_path / "out", "--shard", "auto", "-n")
    assert result.exit_code == 0 and "shard 3/4" in result.stdout
    monkeypatch.delenv("SLURM_ARRAY_TASK_ID")
    result = cli("run", path, "-o", tmp_path / "out", "--shard", "auto")
    assert result.exit_code == 2 and "this process is no task of an array job" in result.stderr


def test_single_tasks_of_an_array_again(tmp_path, monkeypatch):
    """An array of one job would compute everything: `auto` is refused, the position by hand is not."""
    path, out = write(tmp_path), tmp_path / "out"
    command = ("run", path, "-o", out, "-j", 1, "--progress", "none", "--shard")
    assert cli(*command, "1/3").exit_code == 0
    for name, value in slurm(2, 2, 2).items():
        monkeypatch.setenv(name, value)
    result = cli(*command, "auto")
    assert result.exit_code == 2 and "this array has 1 tasks" in result.stderr and "shards of 3" in result.stderr
    assert cli(*command, "2/3").exit_code == 0


@pytest.mark.parametrize(
    ("variables", "most"),
    [
        ({}, 10**6),
        ({"SLURM_CPUS_PER_TASK": "1"}, 1),
        ({"NSLOTS": "1"}, 1),
        ({"NCPUS": "1"}, 1),
        ({"NCPUS": "x"}, 10**6),
    ],
)
def test_cores_of_a_job(variables, most):
    assert n_cores(variables) == min(n_cores({}), most) >= 1
