"""docs/numbers.md: which kept results a higher NUMERICS has moved, from two states of results/.

``PYTHONPATH=tests python -m docs.numbers_page REVISION`` compares the files of a revision with those of the working
tree. The page is history and is not made again by `make docs`.
"""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from docs.markdown import DOCS, ROOT, table, text
from scipy import stats

PAGE = DOCS / "numbers.md"
KEPT = "## Adjusted comparisons\n"  # the last section, which stays as it is
ROUNDING = 1e-6
"""Relative change of a value without a standard error that counts as moved; the files have six digits."""


class Moved(NamedTuple):
    """One row of a table, or one statement: what it is called, and what stands there now and before."""

    row: str
    old: str
    new: str


def keyed(frame: pd.DataFrame, end: str) -> pd.DataFrame:
    """Return a table with its rows named by the columns before and including ``end``.

    Empty ones are left out, and lists and mappings, for which the name of the point stands.
    """
    columns = list(frame.columns[: list(frame.columns).index(end) + 1])
    shown = frame[columns].map(lambda value: "" if pd.isna(value) or str(value)[0] in "{[" else str(value))
    named = shown.apply(lambda row: ", ".join(filter(None, row)), axis=1)
    return frame.set_index(pd.Index(named, name="row"))


def standard_error(row: pd.Series) -> float:
    """Return the standard error of the mean, that of the median of a normal sample, or that of a comparison."""
    if "ci_level" in row:
        low, high = ("ci_low", "ci_high") if not pd.isna(row["change_pct"]) else ("difference_low", "difference_high")
        return float((row[high] - row[low]) / (2 * stats.norm.ppf(0.5 + row["ci_level"] / 2)))
    if pd.isna(row["mean"]) and not np.isfinite([row["q25"], row["q75"]]).all():
        return 0.0
    if pd.isna(row["mean"]):
        return float(1.2533 * (row["q75"] - row["q25"]) / 1.349 / np.sqrt(row["n"]))
    return float(row["se"])


def value(row: pd.Series) -> float:
    """Return the number that a row is about."""
    names = ("change_pct", "difference") if "ci_level" in row else ("mean", "median")
    return float(row[names[0]] if not pd.isna(row[names[0]]) else row[names[1]])


def moved_rows(old: pd.DataFrame, new: pd.DataFrame) -> Iterator[Moved]:
    """Yield the rows of summary.csv or comparisons.csv in both tables that moved by more than their standard error."""
    before, now = keyed(old, "metric"), keyed(new, "metric")
    for row in before.index.intersection(now.index):
        first, second = before.loc[row], now.loc[row]
        a, b, error = value(first), value(second), standard_error(first)
        limit = error if error > 0 else ROUNDING * abs(a)
        words = [each.get("verdict", "") for each in (first, second)]
        words = ["" if pd.isna(word) or not word else f" {word}" for word in words]
        if (abs(b - a) > limit) or (np.isfinite(a) != np.isfinite(b)) or words[0] != words[1]:
            yield Moved(row, f"{a:.6g}{words[0]}", f"{b:.6g}{words[1]}")


def moved_claims(old: dict, new: dict) -> Iterator[Moved]:
    """Yield the statements whose finding, joined finding or one of its inequalities is another one."""
    before = {claim["statement"]: claim for claim in old["claims"]}
    for claim in new["claims"]:
        first = before.get(claim["statement"])
        if first and verdict(first) != verdict(claim):
            yield Moved(claim["statement"], verdict(first), verdict(claim))


def verdict(claim: dict) -> str:
    """Return the finding, what it is over all configurations, and how many of its inequalities hold."""
    held = sum(bool(number["holds"]) for number in claim["numbers"])
    joined = f", {claim['joined']} over all configurations" if claim["joined"] != claim["finding"] else ""
    return f"{claim['finding']}{joined}; {held} of {len(claim['numbers'])} hold"


def only_in_one(old: pd.DataFrame, new: pd.DataFrame) -> str:
    """Return how many rows are new and how many are gone, empty if none."""
    before, now = keyed(old, "metric").index, keyed(new, "metric").index
    counts = {"new rows": len(now.difference(before)), "rows gone": len(before.difference(now))}
    return ", ".join(f"{n} {what}" for what, n in counts.items() if n)


def cause(name: str, written: str) -> str:
    """Return why the numbers of a configuration have moved: a person has written it below its heading on the page."""
    found = re.search(rf"^## {re.escape(name)}\n\n(Cause: .+)$", written, re.MULTILINE)
    if not found:
        raise SystemExit(f"{name} has moved: say why on docs/numbers.md, as `Cause: ..` below its heading")
    return found[1]


def section(name: str, parts: Iterable[tuple[str, str, list[Moved]]], written: str) -> str:
    """Return the part of the page on one configuration, empty if nothing of it has moved."""
    lines = []
    for file, counts, rows in parts:
        if counts or rows:
            lines += [f"`{file}`" + (f" ({counts})" if counts else ""), ""]
        if rows and file.endswith(".json"):
            lines += [table(["Statement", "Before", "Now"], [[text(cell) for cell in row] for row in rows]), ""]
        elif rows:
            lines += ["```text", *(f"{row}: {before}, now {now}" for row, before, now in rows), "```", ""]
    return "\n".join([f"## {name}", "", cause(name, written), "", *lines]) if lines else ""


def main(revision: str) -> None:
    """Write the page."""

    def at(path: str) -> str | None:
        found = subprocess.run(["git", "show", f"{revision}:{path}"], cwd=ROOT, capture_output=True, text=True)
        return found.stdout if found.returncode == 0 else None

    written = PAGE.read_text(encoding="utf-8")
    causes = re.search(r"^\| Cause \|.*?(?=\n\n)", written, re.MULTILINE | re.DOTALL)
    sections, same = [], 0
    for directory in sorted({path.parent for path in (ROOT / "results").glob("*/*/claims.json")}):
        parts = []
        for file in ("claims.json", "summary.csv", "comparisons.csv"):
            path = directory / file
            before = at(str(path.relative_to(ROOT)))
            if before is None or not path.exists():
                continue
            if file == "claims.json":
                parts.append((file, "", list(moved_claims(json.loads(before), json.loads(path.read_text("utf-8"))))))
            else:
                old, new = pd.read_csv(io.StringIO(before)), pd.read_csv(path)
                parts.append((file, only_in_one(old, new), list(moved_rows(old, new))))
        made = section(f"{directory.parent.name}/{directory.name}", parts, written)
        sections, same = [*sections, made] if made else sections, same + (not made)
    head = HEAD.format(revision=revision, same=same, causes=causes[0] if causes else "")
    kept = "".join(written.partition(KEPT)[1:])
    PAGE.write_text("\n".join([head, *sections, kept]).rstrip() + "\n", encoding="utf-8")


HEAD = """# Numbers that have moved

<!-- Made by `PYTHONPATH=tests python -m docs.numbers_page {revision}`; by hand: causes, last section. -->

What is kept below `results/`, at `{revision}` and now (NUMERICS 3). A row of a table is listed where its number has
moved by more than its standard error, or where its verdict is another one. A statement is listed where its finding is
another one, or where one of its inequalities changed sides. In {same} configurations nothing has moved.

{causes}
"""

if __name__ == "__main__":
    main(sys.argv[1])
