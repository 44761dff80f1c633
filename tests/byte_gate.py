"""Compare what two commits write, byte by byte: every configuration at its small size, in one process.

    make bytes BASE=COMMIT            # HEAD beside COMMIT
    python -m byte_gate COMMIT PART   # only configurations whose path contains PART

The results of a commit stay in build/bytes/<commit> and are not computed again.  Files are equal if their bytes are.
Left out are times and dates, git state and directory in manifest.json, measured times in tables and sentences, and
notes on the screen that come when something takes long.  Rows of trials.sqlite are compared by the keys of methods and
columns: their numbers are given in the order in which blocks arrive.  PDF files are compared by their texts and sizes,
for the version of fontTools decides the bytes of their fonts; the SVG file of the same draw is compared byte by byte.
"""

import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from pypdf import PdfReader

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "build" / "bytes"
OF_THE_PROCESS = {
    "progress.json",
    "published.json",
    "seconds.json",
    "timings.csv",
    "trials.sqlite-wal",
    "trials.sqlite-shm",
}
OF_THE_RUN = {"start", "stop", "git", "place", "blas", "fonttools"}
DURATION = re.compile(rb"(?<=(?:failed|trials|o runs)), [0-9.]+ (ms|s|min|h)\b|(?m:^[A-Z].* \.\.\.\n)")
"""How long a run took, which is said where it took long, and what is said of something that takes long."""
TIMINGS = re.compile(rb"(?m)^<tr>.*<td class=\"n\">(?:step|first step|block|start|output)</td>.*</tr>$")
DATE = re.compile(rb"\b20\d\d-\d\d-\d\d\b")
LAUNCH = "import sys; from rmpc_bench.cli import main; sys.argv[0] = 'rmpc-bench'; main()"


def git(*arguments):
    """Output of a git command in the checkout."""
    return subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


def computed(commit, parts, workers):
    """Results of all configurations of a commit (or those with one of `parts` in their path), as directories."""
    tree, done = KEPT / commit / "tree", KEPT / commit / "results"
    if not tree.exists():
        git("worktree", "prune")
        git("worktree", "add", "--detach", "--force", str(tree), commit)
    configs = [path.relative_to(tree) for path in sorted((tree / "configs").rglob("*.yaml"))]
    chosen = [config for config in configs if not parts or any(part in str(config) for part in parts)]
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(lambda config: run(tree, config, done / config.with_suffix("")), chosen))
    return {str(config): done / config.with_suffix("") for config in chosen}


def run(tree, config, place):
    """Run one configuration unless its results are there; what the command says is a result too."""
    if (place / "screen.txt").exists():
        return
    shutil.rmtree(place, ignore_errors=True)
    place.parent.mkdir(parents=True, exist_ok=True)
    options = ["--smoke", "-j", "1", "--fresh", "--if-installed", "--progress", "none", "-o", str(place)]
    ended = subprocess.run(
        [sys.executable, "-P", "-c", LAUNCH, "run", str(config), *options],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree), "COLUMNS": "80", "NUMBA_CACHE_DIR": str(tree.parent / "numba")},
        capture_output=True,
        text=True,
    )
    place.mkdir(exist_ok=True)
    said = (ended.stdout + ended.stderr).replace(str(place), "DIRECTORY").replace(str(tree), "TREE")
    (place / "screen.txt").write_text(f"{said}exit code {ended.returncode}\n", encoding="utf-8")


def without(value, names):
    """A JSON value without the members called `names`, at any depth."""
    if isinstance(value, dict):
        return {key: without(each, names) for key, each in value.items() if key not in names}
    return [without(each, names) for each in value] if isinstance(value, list) else value


def rows(path):
    """Tables of a store as sorted rows, with keys in place of numbers."""
    database = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    keys = dict(database.execute("SELECT number, key FROM keys"))
    columns = {
        number: (kind, keys.get(owner, owner), keys.get(name, name))
        for number, kind, owner, name in database.execute("SELECT number, kind, owner, name FROM columns")
    }
    tables = {}
    for (table,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'"):
        if table in ("keys", "columns"):
            continue
        found = database.execute(f"SELECT * FROM {table}")  # names come from the store itself
        names = [column for column, *_ in found.description]
        known = {"method": keys, "signal": keys, "column": columns}
        tables[table] = sorted(
            repr([known.get(name, {}).get(value, _data(value)) for name, value in zip(names, row, strict=True)])
            for row in found
            if table != "durations"  # wall time
        )
    tables["keys"] = sorted(keys.values())
    tables["columns"] = sorted(map(repr, columns.values()))
    return tables


def _data(value):
    """A stored value; the members of a mapping have no order."""
    try:
        found = json.loads(value) if isinstance(value, str) else None
    except ValueError:
        found = None
    return json.dumps(found, sort_keys=True) if isinstance(found, dict) else value


def content(path, place):
    """What is compared of one file."""
    if path.name == "trials.sqlite":
        return rows(path)
    if path.name == "manifest.json":
        return without(json.loads(path.read_text(encoding="utf-8")), OF_THE_RUN)
    if path.suffix == ".pdf":
        return "\n".join(f"{page.mediabox} {page.extract_text()}" for page in PdfReader(path).pages)
    text = path.read_bytes().replace(str(place).encode(), b"DIRECTORY")
    return TIMINGS.sub(b"", DURATION.sub(b"", DATE.sub(b"DATE", text)))


def differences(old, new):
    """Names of the files of two directories that differ, with the first difference of a text."""
    names = {path.relative_to(place) for place in (old, new) for path in place.rglob("*") if path.is_file()}
    for name in sorted(name for name in names if name.name not in OF_THE_PROCESS):
        if not ((old / name).exists() and (new / name).exists()):
            yield f"{name}: only in {'old' if (old / name).exists() else 'new'}"
            continue
        before, after = content(old / name, old), content(new / name, new)
        if before != after:
            yield f"{name}: {first_difference(before, after)}"


def first_difference(before, after):
    """The first line, table or member in which two contents differ."""
    if isinstance(before, dict):
        where = [key for key in {**before, **after} if before.get(key) != after.get(key)]
        return f"in {', '.join(where)}"
    pairs = zip(before.splitlines() + [b""], after.splitlines() + [b""], strict=False)
    line = next(((i, a, b) for i, (a, b) in enumerate(pairs, 1) if a != b), None)
    return "lengths" if line is None else f"line {line[0]}: {line[1][:100]!r} -> {line[2][:100]!r}"


def main(base, *parts):
    """Print what differs between `base` and HEAD; the exit code is 1 if anything does."""
    workers = int(os.environ.get("BYTES_WORKERS", os.cpu_count() or 1))
    old, new = (computed(git("rev-parse", commit), parts, workers) for commit in (base, "HEAD"))
    wrong = 0
    for config in sorted({**old, **new}):
        if config not in old or config not in new:
            wrong += 1
            print(f"{config}: only in {'old' if config in old else 'new'}")
            continue
        found = list(differences(old[config], new[config]))
        wrong += bool(found)
        print(f"{config}: {'equal' if not found else ''}", *found, sep="\n  " if found else "")
    print(f"{len({**old, **new}) - wrong} of {len({**old, **new})} configurations equal")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
