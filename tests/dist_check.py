"""The distribution as a user gets it: `make dist-check`.

Makes the source archive and, from it, the wheel.  Installs the wheel into a fresh environment outside the checkout,
with the newest libraries for every Python that the machine has, and with the lowest ones for the lowest Python, and
runs the commands of a first day there.  A DeprecationWarning or FutureWarning that a call of this package causes is an
error in these environments, in every process.  Environments with the same libraries must give the same trials.
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import sqlite3
import subprocess
import sys
import tarfile
import time
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
UV = Path(sys.executable).with_name("uv")
NEWEST_KNOWN = 20
"""Interpreters are looked for up to Python 3.20."""
MANAGERS = (".pyenv/versions", ".local/share/uv/python", ".local/share/mise/installs/python", ".asdf/installs/python")
FOLDERS = [Path.home() / name for name in (*MANAGERS, "miniconda3/envs", "miniforge3/envs")] + [Path("/opt/python")]

COMMANDS = (
    "run quickstart",
    "check --deep quickstart",
    "describe kalman",
    "init tanks",
    "run tanks.yaml --smoke",
    "run zenere2018/fig7 --smoke",
)
PAPER = "ma2025"
"""Every configuration of this paper runs at its small size."""

CATEGORIES = ("DeprecationWarning", "FutureWarning")
FILTER = "; ".join(
    ["import warnings", *(rf"warnings.filterwarnings('error', '', {name}, r'rmpc_bench(\.|$)')" for name in CATEGORIES)]
)
"""A line of a .pth file, which every Python process executes when it starts; the module is that of the caller."""
PROBE = "import warnings; warnings.warn_explicit('', {}, '', 1, 'rmpc_bench.probe')"


class Failure(Exception):
    """A command of the check ended otherwise than it should."""


class Outcome(NamedTuple):
    """What an environment has and what it computed."""

    name: str
    libraries: str  # with versions
    seconds: float
    trials: dict[str, str]  # place of a trials.csv -> start of its SHA-256


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
PYTHONS = [name.rpartition(" ")[2] for name in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", name)]
"""Pythons that the project names, such as 3.11, the lowest first."""
DIRECT = {re.split(r"[<>=!~;\[ ]", requirement)[0] for requirement in PROJECT["dependencies"]}


def call(command: list[str | Path], directory: Path, *, fails: bool = False) -> str:
    """Run a command and return what it printed; a failure that was not expected ends the check."""
    dropped = ("PYTHONPATH", "PYTHONDONTWRITEBYTECODE", "VIRTUAL_ENV")
    environment = {name: value for name, value in os.environ.items() if name not in dropped}
    environment["NUMBA_CACHE_DIR"] = str(directory / "numba")
    done = subprocess.run(
        command, cwd=directory, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    if (done.returncode != 0) != fails or ("Traceback" in done.stdout) != fails:
        raise Failure(f"{shlex.join(map(str, command))}: exit code {done.returncode}\n{done.stdout}")
    return done.stdout


def interpreters(lowest: str) -> Iterator[tuple[str, Path]]:
    """Yield name and path of one working interpreter per Python from the lowest on: of PATH, then of the managers."""
    for minor in range(int(lowest.partition(".")[2]), NEWEST_KNOWN + 1):
        name = f"python3.{minor}"
        places = [Path(folder) / name for folder in os.environ["PATH"].split(os.pathsep)]
        places += [path for folder in FOLDERS for path in sorted(folder.glob(f"*/bin/{name}"))]
        # One of PATH may be a stub of a version manager, or lack the standard library.
        ask = ["-c", "import ssl, sqlite3, sys; sys.exit(sys.implementation.name != 'cpython')"]
        for place in filter(Path.is_file, places):
            if subprocess.run([place, *ask], capture_output=True).returncode == 0:
                yield f"3.{minor}", place
                break


def build(directory: Path) -> Path:
    """Make both archives, compare the source archive with the files under version control, and return the wheel."""
    call([UV, "build", "--quiet", "--out-dir", directory, ROOT], directory)
    (archive,), (wheel,) = directory.glob("*.tar.gz"), directory.glob("*.whl")
    if (ROOT / ".git").exists():
        with tarfile.open(archive) as opened:
            packed = {name.partition("/")[2] for name in opened.getnames()} - {"PKG-INFO"}
        tracked = set(call(["git", "-C", ROOT, "ls-files", "-z"], directory).split("\0")) - {""}
        if packed != tracked:
            raise Failure(f"source archive: missing {sorted(tracked - packed)}, too many {sorted(packed - tracked)}")
    return wheel


def tried(name: str, python: Path, wheel: Path, directory: Path) -> Outcome:
    """Install the wheel into a fresh environment and run the commands there."""
    started = time.perf_counter()
    directory.mkdir()
    inside = directory / "venv" / "bin" / "python"
    # The requirements of a wheel are direct ones only where they are given beside it.
    lowest = ["--resolution", "lowest-direct", "-r", ROOT / "pyproject.toml"] if name.endswith("lowest") else []
    call([UV, "venv", "--quiet", "--python", python, inside.parents[1]], directory)
    call([UV, "pip", "install", "--quiet", "--compile-bytecode", "--python", inside, *lowest, wheel], directory)
    site = Path(call([inside, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], directory).strip())
    (site / "warnings_are_errors.pth").write_text(FILTER, encoding="utf-8")
    for category in CATEGORIES:
        call([inside, "-c", PROBE.format(category)], directory, fails=True)
    work = directory / "work"
    work.mkdir()
    paper = [f"run {PAPER}/{path.stem} --smoke" for path in sorted((ROOT / "configs" / PAPER).glob("*.yaml"))]
    for command in (*COMMANDS, *paper):
        call([inside.with_name("rmpc-bench"), *command.split()], work)
    for store in work.rglob("trials.sqlite"):
        with closing(sqlite3.connect(store)) as connection:
            texts = [text for (text,) in connection.execute("SELECT text FROM warnings")]
        if any(text.startswith(CATEGORIES) for text in texts):
            raise Failure(f"{store.relative_to(work)}: {texts}")
    found = {path.relative_to(work).parent.as_posix(): path for path in sorted(work.rglob("trials.csv"))}
    trials = {place: hashlib.sha256(path.read_bytes()).hexdigest()[:12] for place, path in found.items()}
    frozen = call([UV, "pip", "freeze", "--quiet", "--python", inside], directory).splitlines()
    return Outcome(name, " ".join(line for line in frozen if "==" in line), time.perf_counter() - started, trials)


def main() -> int:
    """Check the distribution, print a paragraph per environment, and return the exit code."""
    found = dict(interpreters(PYTHONS[0]))
    with TemporaryDirectory() as folder:
        directory = Path(folder)
        try:
            wheel = build(directory)
            work = [(f"Python {name}, newest", path) for name, path in found.items()]
            work += [(f"Python {name}, lowest", found[name]) for name in PYTHONS[:1] if name in found]
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                places = (directory / f"{number}" for number in range(len(work)))
                done = [*pool.map(lambda job, place: tried(*job, wheel, place), work, places)]
        except Failure as failure:
            print(f"dist-check failed: {failure}", file=sys.stderr)
            return 1
    groups: dict[str, set[str]] = {}
    for each in done:
        direct = [library for library in each.libraries.split() if library.partition("==")[0] in DIRECT]
        print(f"{each.name}: ok in {each.seconds:.0f} s with {' '.join(direct)}")
        print(*(f"    {digest}  {place}/trials.csv" for place, digest in each.trials.items()), sep="\n")
        groups.setdefault(each.libraries, set()).add(str(each.trials))
    for name in PYTHONS:
        if name not in found:
            print(f"Python {name}: no interpreter found")
    different = [libraries for libraries, trials in groups.items() if len(trials) > 1]
    for libraries in different:
        print(f"dist-check failed: Pythons give different trials with {libraries}")
    return 1 if different or not found else 0


if __name__ == "__main__":
    sys.exit(main())
