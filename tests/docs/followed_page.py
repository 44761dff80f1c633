"""A page of the guide, followed literally: its files are written, its commands are run, what they print is compared.

A block ```yaml NAME (or python, or another language) is a file.  A block ```console has one command per line, ``$ ..``.
A block ```text after it is what the last of these commands prints to stdout.

A page of which nothing is compared has fewer runs where RMPC_BENCH_DOC_RUNS is set.

`make docs` runs the commands of the pages `FOLLOWED` and writes their ```text blocks again.
"""

from __future__ import annotations

import atexit
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import forked_commands

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
TUTORIAL = ROOT / "docs" / "tutorial.md"
TUNING = ROOT / "docs" / "tuning.md"
COMING_FROM = ROOT / "docs" / "coming-from.md"
SHORT = tuple(
    ROOT / "docs" / f"{name}.md"
    for name in ("missing-measurements", "delayed-inputs", "nonlinear-estimation", "calibration")
)
"""Pages with one experiment each."""
FOLLOWED = (README, TUTORIAL, TUNING, COMING_FROM, *SHORT)
"""Pages whose ```text blocks are what their commands print."""
BLOCK = re.compile(r"^```(\w+)(?: (\w[\w.-]*))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""Language, name and text; a name is that of a file in the directory of the page."""
SECONDS = re.compile(r"(?<= failed, )\d+(?:\.\d+)? s$", re.MULTILINE)
"""The time that a run took, which is not the same again."""


class Step(NamedTuple):
    """A command of a page and what became of it."""

    line: str
    code: int
    out: str
    err: str
    shown: str | None
    """The ```text block that follows, None without one."""


class Followed(NamedTuple):
    """A page that was followed."""

    place: Path
    """Directory with its files and with what its commands have written, until the process ends."""
    steps: tuple[Step, ...]


@cache
def followed(page: Path) -> Followed:
    """Follow a page in a temporary directory, once per process."""
    place = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, place)
    return Followed(place, tuple(follow(page, place)))


def follow(page: Path, place: Path) -> Iterator[Step]:
    """Write the named blocks of a page below ``place`` and run its commands there, in the order of the page."""
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    languages = [language for language, _, _ in blocks]
    compared = ("console", "text") in pairwise(languages)
    for i, (language, name, text) in enumerate(blocks):
        if name:
            (place / name).write_text(text, encoding="utf-8")
        lines = [line.removeprefix("$ ") for line in text.splitlines() if language == "console"]
        lines = lines if compared else [cut(line) for line in lines]
        after = blocks[i + 1] if i + 1 < len(blocks) else ("", "", "")
        for line in lines:
            shown = after[2] if after[0] == "text" and line == lines[-1] else None
            done = _run(line, place)
            yield Step(line, done.returncode, done.stdout, done.stderr, shown)


def cut(line: str) -> str:
    """Return a command with at most as many runs as RMPC_BENCH_DOC_RUNS says, where it says nothing of them itself."""
    words, runs = shlex.split(line), os.environ.get("RMPC_BENCH_DOC_RUNS")
    whole = not runs or words[:2] != ["rmpc-bench", "run"] or {*words} & {"--runs", "--smoke", "--shard", "--missing"}
    return line if whole else f"{line} --runs {runs}"


def _run(line: str, place: Path) -> subprocess.CompletedProcess[str]:
    program, *arguments = shlex.split(line)
    if program == "rmpc-bench":
        return forked_commands.run(arguments, place)
    command = [sys.executable if program == "python" else program, *arguments]
    environment = {**os.environ, **forked_commands.variable()}
    # A script that calls `rmpc-bench` may reach the process that forks.
    return subprocess.run(
        command, cwd=place, capture_output=True, text=True, check=False, env=environment, close_fds=False
    )


def comparable(text: str) -> str:
    """Return what is printed without the time that the run took, and without spaces at the ends of lines."""
    lines = (line.rstrip() for line in SECONDS.sub("3 s", text).strip("\n").splitlines())
    return "\n".join(lines) + "\n"


def updated(page: Path) -> str:
    """Return the text of a page with every ```text block that follows a command made again.

    Raises
    ------
    RuntimeError
        If a command of the page fails.
    """
    steps = followed(page).steps
    failed = [f"{step.line}: exit code {step.code}\n{step.out}{step.err}" for step in steps if step.code != 0]
    if failed:
        raise RuntimeError("\n".join(failed))
    made = iter([comparable(step.out) for step in steps if step.shown is not None])
    last = ""

    def again(match: re.Match[str]) -> str:
        nonlocal last
        before, last = last, match[1]
        return f"```text\n{next(made)}```" if match[1] == "text" and before == "console" else match[0]

    return BLOCK.sub(again, page.read_text(encoding="utf-8"))
