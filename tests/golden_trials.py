"""Golden trials: numbers of the bench itself, kept to notice a change of the arithmetic.  They are no oracle.

They say that the numbers are those of the commit that renewed them, not that they are right.  Renew the file with
`python tests/golden_trials.py`; where the numbers of an unchanged definition differ, rmpc_bench.NUMERICS must be raised
first, in the same commit.
"""

import csv
import math
import sys
from pathlib import Path
from typing import NamedTuple

import rmpc_bench
from rmpc_bench.config.identity import digest
from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.choice import serial
from rmpc_bench.engines.tasks import Task
from rmpc_bench.types import Status

ROOT = Path(__file__).parents[1]
FILE = Path(__file__).with_suffix(".csv")
CONFIGS = {
    "quickstart": (),
    "zenere2018/fig7": ("smoke.steps=100",),
    "zenere2018/sim2": ("smoke.steps=100",),
    "zenere2017/sim1": ("smoke.steps=100",),
    "souto2011/benchmarks": (),
    "souto2011/comparison": (),
    "souto2011/fig4": (),
    "ma2025/noise-laws": (),
    "ma2025/table1": (),
    "ma2025/table2": (),
    "belda2017/exp1": (),
    "belda2017/fig4": (),
}
"""Configurations at their small size, with what is changed for more of the dynamics, such as friction at rest."""
N_RUNS = 2
RELATIVE, ABSOLUTE = 1e-9, 1e-12
"""What another machine may change (relative), and what is rounding of a number that is zero but for it (absolute)."""


class Key(NamedTuple):
    """Where a number belongs."""

    config: str
    point: str
    method: str
    metric: str


class Golden(NamedTuple):
    """The numbers of the first runs, and the hash of what the configuration determines of them."""

    definition: str
    values: tuple[str, ...]


def computed(name):
    """Return Key -> Golden of the first runs of a configuration at its small size, at the ends of its sweep."""
    path = ROOT / "configs" / f"{name}.yaml"
    config = rmpc_bench.load_config(path, overrides=CONFIGS[name], runs=N_RUNS, smoke=True)
    points, found = config.points, {}
    tasks = [
        Task(method.name, 0, N_RUNS, number)
        for number in sorted({0, len(points) - 1})
        for method in points[number].experiment.methods
    ]
    for done in serial([point.experiment for point in points], TaskQueue(tasks)):
        point, method = points[done.task.point], done.task.method
        columns = {metric.name: done.block.metrics[i] for i, metric in enumerate(point.experiment.metrics)}
        rows = {
            metric: (point.metric_keys[metric], map(repr, map(float, column))) for metric, column in columns.items()
        }
        rows["status"] = "", [Status(code).word for code in done.block.status]
        for metric, (key, values) in rows.items():
            definition = digest([point.definitions[method], key])[:12]
            found[Key(name, point.title, method, metric)] = Golden(definition, tuple(values))
    return found


def stored():
    """Return the number of the arithmetic of the file, and its Key -> Golden."""
    with FILE.open(encoding="utf-8", newline="") as file:
        [[_, numerics], _, *rows] = csv.reader(file)
    return int(numerics), {Key(*row[:4]): Golden(row[4], tuple(row[5:])) for row in rows}


def differs(before, after):
    """Whether two numbers, or two words, differ by more than another machine may make them."""
    try:
        a, b = float(before), float(after)
    except ValueError:
        return before != after
    return not (math.isclose(a, b, rel_tol=RELATIVE, abs_tol=ABSOLUTE) or (math.isnan(a) and math.isnan(b)))


def differences(before, after):
    """Return a line for every golden number that is not computed any more, or differs."""
    lines = []
    for key, golden in before.items():
        new = after.get(key)
        if new is None:
            lines.append(f"{' '.join(key)}: is not computed any more")
        elif any(map(differs, golden.values, new.values)):
            what = "the same definition" if new.definition == golden.definition else "another definition"
            lines.append(f"{' '.join(key)} ({what}): {', '.join(golden.values)} -> {', '.join(new.values)}")
    return lines


def renew():
    """Write the file again, last digits as they are; refuse where the arithmetic has changed under the same number."""
    after = {key: golden for name in CONFIGS for key, golden in computed(name).items()}
    numerics, before = stored() if FILE.exists() else (rmpc_bench.NUMERICS, {})
    changed = [line for line in differences(before, after) if "the same definition" in line]
    if changed and numerics == rmpc_bench.NUMERICS:
        return "\n".join([*changed, f"raise rmpc_bench.NUMERICS, which is {numerics}, and try again"])
    for key, old in before.items():
        if (
            key in after
            and old.definition == after[key].definition
            and not any(map(differs, old.values, after[key].values))
        ):
            after[key] = old
    with FILE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["NUMERICS", rmpc_bench.NUMERICS])
        writer.writerow([*Key._fields, "definition", *(f"run {run}" for run in range(N_RUNS))])
        writer.writerows([*key, golden.definition, *golden.values] for key, golden in after.items())
    return None


if __name__ == "__main__":
    sys.exit(renew())
