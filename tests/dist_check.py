"""The distribution as a user gets it: `make dist-check`.

Makes the source archive and, from it, the wheel.  Installs the wheel into a fresh environment outside the checkout,
with the newest libraries for every Python of the machine, and with the lowest ones for the lowest Python, and runs the
commands of a first day there.  A DeprecationWarning or FutureWarning that a call of this package causes is an error in
these environments, in every process.  Environments with the same libraries must give the same trials.
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
MANAGERS = (".pyenv/versions", ".local/share/uv/python", ".local/share/mise/installs/python", ".asdf/installs/python")
FOLDERS = [Path.home() / name for name in (*MANAGERS, "miniconda3/envs", "miniforge3/envs")] + [Path("/opt/python")]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
PYTHONS = [name.rpartition(" ")[2] for name in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", name)]
"""Pythons that the project names, such as 3.11, the lowest first."""
BOUNDS = dict(requirement.split(">=") for requirement in PROJECT["dependencies"])
PAPER = [f"run ma2025/{path.stem} --smoke" for path in sorted((ROOT / "configs" / "ma2025").glob("*.yaml"))]
FIRST_DAY = "run quickstart; check --deep quickstart; describe kalman; init tanks; run tanks.yaml --smoke"
COMMANDS = [*FIRST_DAY.split("; "), "run zenere2018/fig7 --smoke", *PAPER]
CATEGORIES = ("DeprecationWarning", "FutureWarning")
FILTERS = (rf"warnings.filterwarnings('error', '', {name}, r'rmpc_bench(\.|$)')" for name in CATEGORIES)
HOOK = "; ".join(["import warnings", *FILTERS])
"""A line of a .pth file, which every Python process executes when it starts; the module is that of the caller."""
PROBE = "import warnings; warnings.warn_explicit('', {}, '', 1, 'rmpc_bench.probe')"


class Failure(Exception):
    """A part of the check went otherwise than it should."""


class Outcome(NamedTuple):
    """What an environment has and what it computed."""

    name: str
    versions: dict[str, str]
    seconds: float
    trials: dict[str, str]  # place of a trials.csv -> start of its SHA-256


def call(command: list[str | Path], directory: Path, *, fails: bool = False) -> str:
    """Run a command and return what it printed; a failure that was not expected ends the check."""
    dropped = ("PYTHONPATH", "PYTHONDONTWRITEBYTECODE", "VIRTUAL_ENV")
    environment = {name: value for name, value in os.environ.items() if name not in dropped}
    environment["NUMBA_CACHE_DIR"] = str(directory / "numba")
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run(command, cwd=directory, env=environment, **streams)
    if (done.returncode != 0) != fails or ("Traceback" in done.stdout) != fails:
        raise Failure(f"{shlex.join(map(str, command))}: exit code {done.returncode}\n{done.stdout}")
    return done.stdout


def interpreters() -> Iterator[tuple[str, Path]]:
    """Yield name and path of one working interpreter per Python from the lowest on: of PATH, then of the managers."""
    for minor in range(int(PYTHONS[0].partition(".")[2]), 30):
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


def install(python: Path, wheel: Path, directory: Path, *, lowest: bool) -> tuple[Path, dict[str, str]]:
    """Install the wheel into a fresh environment in which warnings are errors; return its Python and its libraries."""
    inside = directory / "venv" / "bin" / "python"
    # The requirements of a wheel are direct ones only where they are given beside it.
    direct = ["--resolution", "lowest-direct", "-r", ROOT / "pyproject.toml"] if lowest else []
    call([UV, "venv", "--quiet", "--python", python, inside.parents[1]], directory)
    call([UV, "pip", "install", "--quiet", "--compile-bytecode", "--python", inside, *direct, wheel], directory)
    frozen = call([UV, "pip", "freeze", "--quiet", "--python", inside], directory).splitlines()
    versions = dict(line.split("==") for line in frozen if "==" in line)
    higher = [name for name, bound in BOUNDS.items() if lowest and not versions[name].startswith(bound)]
    if higher:
        raise Failure(f"not the lowest versions: {higher} in {versions}")
    site = Path(call([inside, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], directory).strip())
    (site / "warnings_are_errors.pth").write_text(HOOK, encoding="utf-8")
    for category in CATEGORIES:
        call([inside, "-c", PROBE.format(category)], directory, fails=True)
    return inside, versions


def tried(name: str, python: Path, wheel: Path, directory: Path) -> Outcome:
    """Install the wheel, run the commands, and look for warnings that a simulation has counted."""
    started, work = time.perf_counter(), directory / "work"
    work.mkdir(parents=True)
    inside, versions = install(python, wheel, directory, lowest=name.endswith("lowest"))
    for command in COMMANDS:
        call([inside.with_name("rmpc-bench"), *command.split()], work)
    for store in work.rglob("trials.sqlite"):
        with closing(sqlite3.connect(store)) as connection:
            texts = [text for (text,) in connection.execute("SELECT text FROM warnings")]
        if any(text.startswith(CATEGORIES) for text in texts):
            raise Failure(f"{store.relative_to(work)}: {texts}")
    found = {path.relative_to(work).parent.as_posix(): path for path in sorted(work.rglob("trials.csv"))}
    trials = {place: hashlib.sha256(path.read_bytes()).hexdigest()[:12] for place, path in found.items()}
    return Outcome(name, versions, time.perf_counter() - started, trials)


def main() -> int:
    """Check the distribution, print a paragraph per environment, and return the exit code."""
    found, groups = dict(interpreters()), {}
    work = [(f"Python {name}, newest", path) for name, path in found.items()]
    work += [(f"Python {name}, lowest", found[name]) for name in PYTHONS[:1] if name in found]
    with TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            wheel = build(Path(folder))
            done = [*pool.map(lambda job, n: tried(*job, wheel, Path(folder, str(n))), work, range(len(work)))]
        except Failure as failure:
            print(f"dist-check failed: {failure}", file=sys.stderr)
            return 1
    for each in done:
        direct = " ".join(f"{name} {each.versions[name]}" for name in BOUNDS)
        print(f"{each.name}: ok in {each.seconds:.0f} s with {direct}")
        print(*(f"    {digest}  {place}/trials.csv" for place, digest in each.trials.items()), sep="\n")
        groups.setdefault(str(each.versions), set()).add(str(each.trials))
    print("Pythons not found:", ", ".join(name for name in PYTHONS if name not in found) or "none")
    different = [versions for versions, trials in groups.items() if len(trials) > 1]
    print("different trials with the same libraries:", "; ".join(different) or "none")
    return 1 if different or not found else 0


if __name__ == "__main__":
    sys.exit(main())
