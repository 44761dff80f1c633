"""``python -m perf``: measure every row and write results/perf/perf.md and perf.json.

Both sides of a row run one after the other, each in a process of its own, so that their ratio depends little on the
machine and its load.  Time is that of all processors.  Memory is the largest of the process or one of its children.
The numbers that both sides compute are compared; a row whose sides differ by more than
its tolerance, or fail, is not in the table, and the exit code is then 1.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np

from perf import (
    commands,
    gpc_rows,
    horizon_rows,
    large,
    libraries,
    linear_rows,
    loops,
    mpc_rows,
    nonlinear_rows,
    outlier_rows,
    solvers,
    wasserstein_rows,
)
from perf.row import measured

ROWS = [*loops.ROWS, *linear_rows.ROWS, *solvers.ROWS, *gpc_rows.ROWS, *mpc_rows.ROWS]
ROWS += [*horizon_rows.ROWS, *nonlinear_rows.ROWS, *outlier_rows.ROWS, *libraries.ROWS, *commands.ROWS]
ROWS += wasserstein_rows.ROWS
HERE = Path(__file__).parents[2]
TARGET = HERE / "results" / "perf"
PAIRS = 5
"""Alternations of two checkouts."""
COMPARED = 50
"""Numbers of a side that are compared."""


class RowError(Exception):
    """A row whose sides fail or differ."""


def one_side(number, side):
    """Measure one side of a row in this process and print it."""
    seconds, result = measured(getattr(ROWS[number], side), ROWS[number].clock)
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1e3
    print(json.dumps({"seconds": seconds, "megabytes": peak, "numbers": numbers(result)}))


def numbers(result):
    """Return what is compared of the result of a side, None if it has no numbers."""
    return None if result is None else np.ravel(result)[:COMPARED].tolist()


def in_process(number, side, directory=None):
    """Measure one side of a row in a process of its own, of the package in a directory if one is given."""
    command = [sys.executable, "-W", "ignore", "-m", "perf", "--side", str(number), side]
    path = os.pathsep.join([str(directory), str(Path(__file__).parents[1])])
    env = None if directory is None else {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=directory, env=env)
    if done.returncode:
        raise RowError(f"{ROWS[number].name}, {side}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def both_sides(number):
    """Measure a row and compare what its sides compute."""
    row = ROWS[number]
    found = {side: in_process(number, side) for side in ("ours", "baseline")[: 1 + (row.baseline is not None)]}
    compared = [side.pop("numbers") for side in found.values()]
    found["difference"] = difference(*compared) if len(compared) == 2 and None not in compared else None
    if found["difference"] is not None and not found["difference"] <= row.tolerance:
        raise RowError(f"{row.name}: the sides differ by {found['difference']:.2g} (tolerance {row.tolerance:.0e})")
    return {"name": row.name, "unit": row.unit, "beside": row.beside, **found}


def beside(directory, wanted):
    """Measure our side of rows here and in another checkout, in alternation, and print least times and ratios."""
    for number, row in enumerate(ROWS):
        if row.name not in (each.name for each in ROWS[:number]) and wanted in row.name:
            pairs = [[in_process(number, "ours", each)["seconds"] for each in (HERE, directory)] for _ in range(PAIRS)]
            here, there = np.array(pairs).T
            times, ratio = f"{text(here.min())} and {text(there.min())} per {row.unit}", here.min() / there.min()
            medians = np.median(here) / np.median(there)
            print(f"{row.name}: {times}; ratio {ratio:.3f}, of medians {medians:.3f}", flush=True)


def difference(ours, other):
    """Return the largest difference of numbers that both sides have, relative to the largest number."""
    n = min(len(ours), len(other))
    a, b = np.array(ours[:n]), np.array(other[:n])
    return float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-300))


def text(seconds):
    """Write a time with a unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def line(each):
    """Return a row of the table in Markdown."""
    ours, other = each["ours"], each.get("baseline")
    if other is None:
        head = f"| {each['name']} | {each['unit']} | {text(ours['seconds'])} | {each['beside']} "
        return f"{head}| | | | {ours['megabytes']:.0f} MB | |"
    same = "" if each["difference"] is None else f"{each['difference']:.0e}"
    return (
        f"| {each['name']} | {each['unit']} | {text(ours['seconds'])} | {each['beside']} | {text(other['seconds'])} "
        f"| {other['seconds'] / ours['seconds']:.3g} | {same} | {ours['megabytes']:.0f} MB "
        f"| {other['megabytes']:.0f} MB |"
    )


def table(records):
    """Return the table in Markdown."""
    lines = [
        "# Speed and memory",
        "",
        f"Written by `make perf` with Python {platform.python_version()} on {platform.machine()}. Both sides of a row",
        "were measured one after the other, each in its own process and after a first call that does not count. Time",
        "is CPU time of all processors per unit of work, unless the row names another. The ratio is the time of the",
        "baseline divided by ours. The difference is that of the computed numbers, relative to the largest of them; it",
        "is empty for a baseline that computes less. Memory is the peak of the largest process.",
        "",
        "| work | unit | ours | baseline | time | ratio | difference | memory, ours | memory, baseline |",
        "|---|---|---|---|---|---|---|---|---|",
        *map(line, records),
    ]
    return "\n".join(lines) + "\n"


def arguments():
    """Return what the command line asks for."""
    parser = argparse.ArgumentParser("python -m perf", description="Measure every row and write results/perf.")
    parser.add_argument("--rows", metavar="TEXT", default="", help="print only rows with this text in their names")
    parser.add_argument("--beside", metavar="DIRECTORY", type=Path, help="print --rows here and of another checkout")
    parser.add_argument("--large", metavar="N", nargs="*", type=int, help="large numbers of runs in place of the rows")
    parser.add_argument("--side", nargs=2, help=argparse.SUPPRESS)
    return parser.parse_args()


def main(asked):
    """Measure one side of a row, large experiments, rows of two checkouts, or all rows."""
    if asked.large is not None:
        return large.main(TARGET, asked.large or large.SIZES)
    if asked.side:
        return one_side(int(asked.side[0]), asked.side[1])
    if asked.beside:
        return beside(asked.beside.resolve(), asked.rows)
    records, errors = [], []
    for number, row in enumerate(ROWS):
        if asked.rows in row.name:
            try:
                records.append(both_sides(number))
                print(line(records[-1]), file=sys.stderr, flush=True)
            except RowError as error:
                errors.append(str(error))
                print(f"no row: {error}", file=sys.stderr, flush=True)
    if not asked.rows:
        TARGET.mkdir(parents=True, exist_ok=True)
        (TARGET / "perf.md").write_text(table(records), encoding="utf-8")
        (TARGET / "perf.json").write_text(json.dumps(records, indent=2) + "\n", encoding="utf-8")
    if errors:
        raise SystemExit(1)
    return None


if __name__ == "__main__":
    main(arguments())
