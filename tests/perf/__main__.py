"""``python -m perf``: measure every row and write results/perf/perf.md and perf.json; ``--large`` for the long rows.

Both sides of a row run one after the other, each in a process of its own, so that their ratio depends little on the
machine and its load.  Time is that of all processors.  Memory is the largest of the process or one of its children.
"""

import json
import platform
import resource
import subprocess
import sys
from pathlib import Path

from perf import commands, loops, solvers
from perf.row import measured

ROWS = [*loops.ROWS, *solvers.ROWS, *commands.ROWS]
TARGET = Path(__file__).parents[2] / "results" / "perf"


def one_side(number, side):
    """Measure one side of a row in this process and print it."""
    row = ROWS[number]
    seconds = measured(getattr(row, side), rounds=1 if row.large else 3)
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1e3
    print(json.dumps({"seconds": seconds, "megabytes": peak}))


def both_sides(number):
    """Measure a row; the sides run in turns, and the least time counts."""
    found = {}
    for side in ("ours", "baseline"):
        command = [sys.executable, "-W", "ignore", "-m", "perf", str(number), side]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{ROWS[number].name}, {side}: {done.stderr.strip().splitlines()[-1]}")
        found[side] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


def text(seconds):
    """Write a time with a unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def table(records):
    """Return the table in Markdown."""
    lines = [
        "# Speed and memory",
        "",
        f"Written by `make perf` with Python {platform.python_version()} on {platform.machine()}. Both sides of a row",
        "were measured one after the other. Time is that of all processors. The ratio is the time of the baseline",
        "divided by ours.",
        "",
        "| work | unit | ours | baseline | time | ratio | memory, ours | memory, baseline |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for each in records:
        ours, other = each["ours"], each["baseline"]
        lines.append(
            f"| {each['name']} | {each['unit']} | {text(ours['seconds'])} "
            f"| {each['beside']} | {text(other['seconds'])} "
            f"| {other['seconds'] / ours['seconds']:.3g} | {ours['megabytes']:.0f} MB | {other['megabytes']:.0f} MB |"
        )
    return "\n".join(lines) + "\n"


def main(arguments):
    """Measure one side, or write the table."""
    if len(arguments) == 2:
        return one_side(int(arguments[0]), arguments[1])
    large = arguments == ["--large"]
    records = []
    for number, row in enumerate(ROWS):
        if row.large == large:
            found = {"name": row.name, "unit": row.unit, "beside": row.beside, **both_sides(number)}
            records.append(found)
            print(
                f"{row.name}: {found['baseline']['seconds'] / found['ours']['seconds']:.3g}",
                file=sys.stderr,
                flush=True,
            )
    TARGET.mkdir(parents=True, exist_ok=True)
    name = "perf-large" if large else "perf"
    (TARGET / f"{name}.md").write_text(table(records), encoding="utf-8")
    (TARGET / f"{name}.json").write_text(json.dumps(records, indent=2) + "\n", encoding="utf-8")
    return None


if __name__ == "__main__":
    main(sys.argv[1:])
