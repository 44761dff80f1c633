"""``python -m perf``: measure every row and write results/perf/perf.md and perf.json.

``--large`` measures 100,000 and 1,000,000 runs in place of the rows, ``--large N ..`` other numbers of runs, and
``--rows TEXT`` prints the rows whose names have a text in them.

Both sides of a row run one after the other, each in a process of its own, so that their ratio depends little on the
machine and its load.  Time is that of all processors.  Memory is the largest of the process or one of its children.
The numbers that both sides compute are compared; a row whose sides differ by more than
its tolerance, or fail, is not in the table, and the exit code is then 1.
"""

import json
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
TARGET = Path(__file__).parents[2] / "results" / "perf"
COMPARED = 50
"""Numbers of a side that are compared."""


class RowError(Exception):
    """A row whose sides fail or differ."""


def one_side(number, side):
    """Measure one side of a row in this process and print it."""
    seconds, result = measured(getattr(ROWS[number], side), ROWS[number].clock)
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1e3
    numbers = None if result is None else np.ravel(result)[:COMPARED].tolist()
    print(json.dumps({"seconds": seconds, "megabytes": peak, "numbers": numbers}))


def both_sides(number):
    """Measure a row and compare what its sides compute."""
    found, row = {}, ROWS[number]
    for side in ("ours", "baseline")[: 1 + (row.baseline is not None)]:
        command = [sys.executable, "-W", "ignore", "-m", "perf", str(number), side]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RowError(f"{row.name}, {side}: {done.stderr.strip().splitlines()[-1]}")
        found[side] = json.loads(done.stdout.strip().splitlines()[-1])
    numbers = [side.pop("numbers") for side in found.values()]
    found["difference"] = difference(*numbers) if len(numbers) == 2 and None not in numbers else None
    if found["difference"] is not None and not found["difference"] <= row.tolerance:
        raise RowError(f"{row.name}: the sides differ by {found['difference']:.2g} (tolerance {row.tolerance:.0e})")
    return {"name": row.name, "unit": row.unit, "beside": row.beside, **found}


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


def main(arguments):
    """Measure one side of a row, large experiments, or all rows."""
    if arguments[:1] == ["--large"]:
        return large.main(TARGET, [int(each) for each in arguments[1:]] or large.SIZES)
    if len(arguments) == 2 and arguments[0].isdigit():
        return one_side(int(arguments[0]), arguments[1])
    wanted = arguments[1] if arguments[:1] == ["--rows"] else ""
    records, errors = [], []
    for number, row in enumerate(ROWS):
        if wanted in row.name:
            try:
                records.append(both_sides(number))
                print(line(records[-1]), file=sys.stderr, flush=True)
            except RowError as error:
                errors.append(str(error))
                print(f"no row: {error}", file=sys.stderr, flush=True)
    if not wanted:
        TARGET.mkdir(parents=True, exist_ok=True)
        (TARGET / "perf.md").write_text(table(records), encoding="utf-8")
        (TARGET / "perf.json").write_text(json.dumps(records, indent=2) + "\n", encoding="utf-8")
    if errors:
        raise SystemExit(1)
    return None


if __name__ == "__main__":
    main(sys.argv[1:])
