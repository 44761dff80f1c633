"""100,000 and 1,000,000 runs of Fig. 7 as commands, beside plain programs extrapolated from 20 runs.

Memory is the largest resident set of the process and of each process below it, as Linux counts it.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from perf.programs import FIG7, program
from perf.row import cpu

SIZES, METHODS, JOBS, RUNS_OF_A_PROGRAM = (100_000, 1_000_000), 4, 2, 20
INTERVAL = 0.1
"""Time between two looks at the processes [s]; Linux itself keeps the largest memory of each."""
PROGRAMS = {"gains": "loop: filterpy, solve_ivp with events", "do-mpc": "the same loop with do-mpc"}


def below(process):
    """Return the numbers of all processes below one."""
    children: dict[int, list[int]] = {}
    for each in Path("/proc").iterdir():
        if each.name.isdigit():
            try:
                parent = int((each / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
            children.setdefault(parent, []).append(int(each.name))
    found, left = [], [process]
    while left:
        new = children.get(left.pop(), [])
        found += new
        left += new
    return found


def megabytes(process):
    """Return the largest memory of a process up to now [MB]; 0 if it has ended."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) * 1.024e-3 for line in lines if line.startswith("VmHWM")), 0.0)


def command(*arguments):
    """Run the package's command and return its CPU time [s], time that passes [s], and memory [MB]."""
    before, start = cpu(), time.monotonic()
    code = "from rmpc_bench.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    parent, workers = 0.0, 0.0
    while process.poll() is None:
        parent = max(parent, megabytes(process.pid))
        workers = max([workers, *map(megabytes, below(process.pid))])
        time.sleep(INTERVAL)
    used, passed = cpu() - before, time.monotonic() - start
    error = process.stderr.read()
    if process.returncode:
        raise SystemExit(f"{' '.join(arguments)}: exit code {process.returncode}: {error.strip()[-500:]}")
    return {"cpu": used, "wall": passed, "parent": parent, "workers": workers}


def measured(n_runs):
    """Compute so many runs, then make the report again."""
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary) / "fig7"
        options = ["--runs", str(n_runs), "-j", str(JOBS), "--progress", "none"]
        found = command("run", FIG7, "-o", str(place), *options)
        size = sum(each.stat().st_size for each in place.glob("trials.sqlite*")) / 1e6
        return {"runs": n_runs, "run": found, "store": size, "report": command("report", str(place))}


def seconds_of_a_run(law):
    """Return the time of a run of a plain program [s], in this process."""
    work, before = program(law, RUNS_OF_A_PROGRAM), cpu()
    work()
    return (cpu() - before) / RUNS_OF_A_PROGRAM


def table(records, programs):
    """Return the table in Markdown."""
    per_run = ", ".join(f"{name}: {programs[law]:.3g} s" for law, name in PROGRAMS.items())
    lines = [
        "# Large experiments",
        "",
        f"Written by `make perf-large`: Fig. 7 of zenere2018 with {METHODS} methods on {JOBS} worker processes and",
        f"{os.cpu_count()} processors, from the command to its figures, and then `rmpc-bench report` again. CPU time",
        "is that of all processors. The plain programs compute the errors only; their times are those of",
        f"{RUNS_OF_A_PROGRAM} runs with S-MPC (per run: {per_run}), extrapolated.",
        "",
        "| runs x methods | CPU | time that passed | memory: command | memory: largest worker | store | per trial "
        "| report, CPU | report, time that passed "
        + "".join(f"| {name}, CPU | ratio " for name in PROGRAMS.values())
        + "|",
        "|" + "---|" * (9 + 2 * len(PROGRAMS)),
    ]
    for each in records:
        run, report, trials = each["run"], each["report"], each["runs"] * METHODS
        others = "".join(
            f"| {programs[law] * trials / 3600:.3g} h | {programs[law] * trials / run['cpu']:.3g} " for law in PROGRAMS
        )
        lines.append(
            f"| {each['runs']:,} x {METHODS} | {run['cpu']:.1f} s | {run['wall']:.1f} s | {run['parent']:.0f} MB "
            f"| {run['workers']:.0f} MB | {each['store']:.1f} MB | {1e6 * each['store'] / trials:.0f} bytes "
            f"| {report['cpu']:.1f} s | {report['wall']:.1f} s {others}|"
        )
    return "\n".join(lines) + "\n"


def main(target, sizes=SIZES):
    """Measure all sizes and the plain programs, and write perf-large.md and perf-large.json."""
    # A first run compiles what is not compiled yet.
    with tempfile.TemporaryDirectory() as temporary:
        command("run", FIG7, "-o", str(Path(temporary) / "fig7"), "--runs", "2", "-j", "1", "--progress", "none")
    programs = {law: seconds_of_a_run(law) for law in PROGRAMS}
    records = []
    target.mkdir(parents=True, exist_ok=True)
    for n_runs in sizes:
        records.append(measured(n_runs))
        # After each size, so that an interruption of a long one loses only this.
        (target / "perf-large.md").write_text(table(records, programs), encoding="utf-8")
        found = {"programs": programs, "sizes": records}
        (target / "perf-large.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
        print(table(records, programs).splitlines()[-1], file=sys.stderr, flush=True)
