"""Stand-ins for the commands of batch schedulers: they run the tasks of an array one after the other.

They read the array from the directives of the script, as a scheduler does, and set its variables.
"""

import os
import stat
import sys
from pathlib import Path

PROGRAM = """#!{python}
import os, re, subprocess, sys
from pathlib import Path

script = Path(sys.argv[-1])
text = script.read_text()
name = Path(sys.argv[0]).name

def array(directive):
    first, last = re.search(directive + r"(\\d+)-(\\d+)", text).groups()
    return int(first), int(last)

def run(first, last, variables):
    for index in range(first, last + 1):
        set_here = {{key: str(value) for key, value in variables(index).items()}}
        done = subprocess.run(["bash", str(script)], env={{**os.environ, **set_here}}, close_fds=False)
        if done.returncode:
            sys.exit(done.returncode)

if name == "sbatch":
    first, last = array("#SBATCH --array=")
    cores = re.search(r"--cpus-per-task=(\\d+)", text)[1]
    run(first, last, lambda index: {{
        "SLURM_ARRAY_TASK_ID": index, "SLURM_ARRAY_TASK_MIN": first, "SLURM_ARRAY_TASK_MAX": last,
        "SLURM_ARRAY_TASK_COUNT": last - first + 1, "SLURM_ARRAY_TASK_STEP": 1, "SLURM_CPUS_PER_TASK": cores}})
elif "#PBS" in text:
    first, last = array("#PBS -J ")
    run(first, last, lambda index: {{
        "PBS_ARRAY_INDEX": index, "PBS_ARRAY_ID": f"7[].{{first}}-{{last}}", "PBS_JOBID": f"7[{{index}}].node",
        "PBS_O_WORKDIR": os.getcwd(), "NCPUS": 1}})
else:
    first, last = array(r"#\\$ -t ")
    run(first, last, lambda index: {{
        "SGE_TASK_ID": index, "SGE_TASK_FIRST": first, "SGE_TASK_LAST": last, "SGE_TASK_STEPSIZE": 1, "NSLOTS": 1}})
"""
QSTAT = """#!{python}
import sys

assert sys.argv[1] == "-f"
print("Job Id:", sys.argv[2])
print("    Job_Name = study")
print("    array_indices_submitted =", sys.argv[2].split(".")[1])
"""
BENCH = """#!{python} -P
import sys

from forked_commands import run_in_child

code = run_in_child(sys.argv[1:])
if code is None:
    from rmpc_bench.cli import main

    main()
sys.exit(code)
"""
JOBQUEUE = '''
"""Stand-in for dask-jobqueue: the workers are processes of this machine."""

import logging

from distributed import LocalCluster


class SLURMCluster(LocalCluster):
    def __init__(self, cores, processes, memory, walltime):
        # A worker that ends during a heartbeat writes a traceback to its log.
        quiet = {"dashboard_address": None, "silence_logs": logging.CRITICAL}
        super().__init__(n_workers=0, threads_per_worker=cores // processes, **quiet)
        self.processes = processes

    def scale(self, jobs):
        super().scale(jobs * self.processes)
'''


def write_commands(directory: Path) -> dict[str, str]:
    """Write sbatch, qsub, qstat, rmpc-bench and the module dask_jobqueue; return the variables that make them found."""
    texts = {"sbatch": PROGRAM, "qsub": PROGRAM, "qstat": QSTAT, "rmpc-bench": BENCH}
    for name, text in texts.items():
        path = directory / name
        path.write_text(text.format(python=sys.executable), encoding="utf-8")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
    (directory / "dask_jobqueue.py").write_text(JOBQUEUE, encoding="utf-8")
    package = Path(__file__).parents[2]
    places = [str(directory), str(package), str(package / "tests"), os.environ.get("PYTHONPATH", "")]
    return {
        "PATH": os.pathsep.join([str(directory), str(Path(sys.executable).parent), os.environ["PATH"]]),
        "PYTHONPATH": os.pathsep.join(filter(None, places)),
    }
