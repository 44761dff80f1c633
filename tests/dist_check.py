"""The distribution as a user gets it: `make dist-check`, and before a release `make release-check`.

Makes the source archive and, from it, the wheel.  Installs the wheel into a fresh environment outside the checkout,
with the newest libraries for every Python of the machine, and with the lowest ones for the lowest Python, and runs the
commands that a new user gives first.  A DeprecationWarning or FutureWarning that a call of this package causes is an
error in these environments, in every process.  Environments with the same versions of the libraries that the project
names must give the same trials.

Before a release, tools in an environment of their own check the metadata and both archives, and some tests run in the
unpacked source archive.  Only the package index is asked for anything.
"""

from __future__ import annotations

import argparse
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
FIRST = "run quickstart; check --deep quickstart; describe kalman; init tanks; run tanks.yaml --smoke"
COMMANDS = [*FIRST.split("; "), "run zenere2018/fig7 --smoke", *PAPER]
CHECKS = (
    "cffconvert --validate --infile {root}/CITATION.cff",
    "validate-pyproject {root}/pyproject.toml",
    "twine check --strict {archive} {wheel}",
    "check-wheel-contents {wheel}",
    "pyroma --min 8 {root}",  # of 10; the others need an address of a person and one of the project
)
"""Commands of the tools in the extra `release`."""
IN_ARCHIVE = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/types", "tests/test_installation.py"]
CATEGORIES = ("DeprecationWarning", "FutureWarning")
FILTERS = (rf"warnings.filterwarnings('error', '', {name}, r'rmpc_bench(\.|$)')" for name in CATEGORIES)
HOOK = "; ".join(["import warnings", *FILTERS])
"""A line of a .pth file, which every Python process executes when it starts; the module is that of the caller."""
PROBE = "import warnings; warnings.warn_explicit('', {}, '', 1, 'rmpc_bench.probe')"


class Failure(Exception):
    """A step of the check failed."""


class Outcome(NamedTuple):
    """What an environment has and what it computed."""

    name: str
    seconds: float
    versions: str = ""  # of the dependencies that the project names
    trials: str = ""  # a line per trials.csv: start of its SHA-256, and its place
    failure: str = ""


def call(command: list[str | Path], directory: Path, *, fails: bool = False) -> str:
    """Run a command and return what it printed; Failure if it fails or, with `fails`, if it succeeds."""
    dropped = ("PYTHONPATH", "PYTHONDONTWRITEBYTECODE", "VIRTUAL_ENV", "RMPC_BENCH_TESTS", "PYTEST_ADDOPTS")
    environment = {name: value for name, value in os.environ.items() if name not in dropped}
    environment["VALIDATE_PYPROJECT_NO_NETWORK"] = "1"
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
        # One of PATH may be a stub of a version manager, lack the standard library, or come before its release.
        good = "sys.implementation.name == 'cpython' and sys.version_info.releaselevel == 'final'"
        ask = ["-c", f"import ssl, sqlite3, sys; sys.exit(not ({good}))"]
        for place in filter(Path.is_file, places):
            if subprocess.run([place, *ask], capture_output=True).returncode == 0:
                yield f"3.{minor}", place
                break


def build(directory: Path) -> tuple[Path, Path]:
    """Make the source archive and the wheel; the first has all files under version control and no others."""
    call([UV, "build", "--quiet", "--out-dir", directory, ROOT], directory)
    (archive,), (wheel,) = directory.glob("*.tar.gz"), directory.glob("*.whl")
    if (ROOT / ".git").exists():
        with tarfile.open(archive) as opened:
            packed = {name.partition("/")[2] for name in opened.getnames()} - {"PKG-INFO"}
        tracked = set(call(["git", "-C", ROOT, "ls-files", "-z"], directory).split("\0")) - {""}
        if packed != tracked:
            raise Failure(f"source archive: missing {sorted(tracked - packed)}, too many {sorted(packed - tracked)}")
    return archive, wheel


def check_release(archive: Path, wheel: Path, directory: Path) -> None:
    """Check metadata and archives with the tools of the extra `release`, and run tests in the source archive."""
    programs = directory / "tools" / "bin"
    call([UV, "venv", "--quiet", "--python", sys.executable, programs.parent], directory)
    tools = PROJECT["optional-dependencies"]["release"]
    call([UV, "pip", "install", "--quiet", "--python", programs / "python", *tools], directory)
    for check in CHECKS:
        name, *arguments = (word.format(root=ROOT, archive=archive, wheel=wheel) for word in check.split())
        lines = call([programs / name, *arguments], directory).strip().splitlines()
        print(f"{name}:", next((line for line in lines if "rating" in line), lines[-1]).strip())
    with tarfile.open(archive) as opened:
        opened.extractall(directory, filter="data")
    done = call([sys.executable, *IN_ARCHIVE], directory / archive.name.removesuffix(".tar.gz"))
    print("tests of the source archive:", done.strip().splitlines()[-1])
    print(", ".join(f"{each.name}: {each.stat().st_size / 1e6:.2f} MB" for each in (archive, wheel)))


def install(python: Path, wheel: Path, directory: Path, *, lowest: bool) -> tuple[Path, dict[str, str]]:
    """Install the wheel into a fresh environment in which warnings are errors; return its Python and its libraries."""
    inside = directory / "venv" / "bin" / "python"
    # For uv the requirements of a wheel are indirect; those of pyproject.toml are direct.
    direct = ["--resolution", "lowest-direct", "-r", ROOT / "pyproject.toml"] if lowest else []
    call([UV, "venv", "--quiet", "--python", python, inside.parents[1]], directory)
    call([UV, "pip", "install", "--quiet", "--compile-bytecode", "--python", inside, *direct, wheel], directory)
    frozen = call([UV, "pip", "freeze", "--python", inside], directory).splitlines()
    versions = dict(line.split("==") for line in frozen if "==" in line)
    higher = [name for name, bound in BOUNDS.items() if lowest and not versions[name].startswith(bound)]
    if higher:
        raise Failure(f"not the lowest versions: {higher} in {versions}")
    site = Path(call([inside, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], directory).strip())
    (site / "warnings_are_errors.pth").write_text(HOOK, encoding="utf-8")
    for category in CATEGORIES:
        call([inside, "-c", PROBE.format(category)], directory, fails=True)
    return inside, versions


def checked(name: str, python: Path, wheel: Path, directory: Path) -> Outcome:
    """Check one environment; a failure belongs to its outcome, so that the others are checked as well."""
    started, direct, trials, failure = time.perf_counter(), "", "", ""
    (directory / "work").mkdir(parents=True)
    try:
        inside, versions = install(python, wheel, directory, lowest=name.endswith("lowest"))
        direct = " ".join(f"{library} {versions[library]}" for library in BOUNDS)
        trials = computed(inside.with_name("rmpc-bench"), directory / "work")
    except Failure as error:
        failure = str(error)
    return Outcome(name, time.perf_counter() - started, direct, trials, failure)


def computed(program: Path, work: Path) -> str:
    """Run the commands, look for warnings that a simulation has counted, and return the trials as text."""
    for command in COMMANDS:
        call([program, *command.split()], work)
    for store in work.rglob("trials.sqlite"):
        with closing(sqlite3.connect(store)) as connection:
            texts = [text for (text,) in connection.execute("SELECT text FROM warnings")]
        if any(text.startswith(CATEGORIES) for text in texts):
            raise Failure(f"{store.relative_to(work)}: {texts}")
    found = [(hashlib.sha256(path.read_bytes()).hexdigest()[:12], path) for path in sorted(work.rglob("trials.csv"))]
    return "\n".join(f"    {digest}  {path.relative_to(work)}" for digest, path in found)


def main() -> int:
    """Check the distribution, print a paragraph per environment, and return the exit code."""
    parser = argparse.ArgumentParser(prog="dist_check", description=__doc__)
    parser.add_argument("--release", action="store_true", help="check the metadata and the source archive as well")
    parser.add_argument("--turn", type=int, help="check two environments only; others for the next number")
    given = parser.parse_args()
    found = dict(interpreters())
    work = [(f"Python {name}, newest", path) for name, path in found.items()]
    work += [(f"Python {name}, lowest", found[name]) for name in PYTHONS[:1] if name in found]
    if given.turn is not None:
        # Each twice among as many turns as there are environments; two with equal libraries are compared once.
        work = [work[(given.turn + i) % len(work)] for i in range(min(2, len(work)))]
    print("Pythons not found:", ", ".join(name for name in PYTHONS if name not in found) or "none")
    with TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            archive, wheel = build(Path(folder))
            if given.release:
                check_release(archive, wheel, Path(folder))
        except Failure as failure:
            print(f"dist-check failed: {failure}")
            return 1
        outcomes = [*pool.map(lambda job, n: checked(*job, wheel, Path(folder, str(n))), work, range(len(work)))]
    groups: dict[str, list[Outcome]] = {}
    for each in outcomes:
        print(f"{each.name}: {'FAILED' if each.failure else 'ok'} in {each.seconds:.0f} s with {each.versions}")
        print(each.failure or each.trials)
        groups.setdefault(each.versions, []).append(each)
    different = False
    for group in (each for each in groups.values() if len(each) > 1):
        same = len({each.trials for each in group}) == 1
        print(f"trials {'equal' if same else 'DIFFERENT'}: {'; '.join(each.name for each in group)}")
        different |= not same
    return 1 if different or not found or any(each.failure for each in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
