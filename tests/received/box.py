"""The place of one case of the battery, the commands that take it, and what may not have happened after them."""

import hashlib
import os
import random
import stat
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

from received.audited_commands import PATIENCE, SECONDS

MEMORY = 500.0
"""Largest memory of a command [MB]."""
TRACE = "Traceback (most recent call last)"


class Case(NamedTuple):
    """A hostile file or directory.

    Parameters
    ----------
    kind : of the attack
    name : of the case
    make : function of a `Box` that writes the files and yields `Command`s; a later one may follow another alteration
    """

    kind: str
    name: str
    make: Any

    @property
    def id(self):
        """Name in the list of tests."""
        return f"{self.kind}-{self.name}"


class Command(NamedTuple):
    """A command of a case.

    Parameters
    ----------
    words : its arguments
    named : directories and files that the user names, which may be written
    codes : exit codes that are right
    environ : variables of the environment
    note : what was altered, for messages
    """

    words: tuple
    named: tuple
    codes: tuple = (0, 1, 2)
    environ: dict = {}
    note: str = ""


class Box:
    """A directory with the files of a case, and with other files that nobody may change.

    Parameters
    ----------
    root : an empty directory
    honest : the results to alter
    case : its identity
    seed : of the battery
    """

    def __init__(self, root, honest, case, seed=0):
        self.root, self.honest = root, honest
        self.random = random.Random(f"{seed} {case}")
        self.here, self.outside, self.home, self.tmp = (root / each for each in ("here", "outside", "home", "tmp"))
        for each in (self.here, self.outside / "elsewhere", self.home, self.tmp):
            each.mkdir(parents=True)
        (self.outside / "precious").write_text("mine\n", encoding="utf-8")
        (self.outside / "elsewhere" / "precious.csv").write_text("a,b\n1,2\n", encoding="utf-8")
        self.mark = self.outside / "PWNED"
        self.shell = f"touch {self.mark}"
        """Command of a shell whose effect is seen."""
        self.python = f"open({str(self.mark)!r}, 'w').close()\n"
        """Program of Python whose effect is seen."""

    def results(self, name="plain"):
        """Copy honest results to the place of the case."""
        return self.honest.copy(name, self.here / name)

    def run(self, server, command):
        """Run a command; return its outcome and what is wrong with it."""
        before = self._seen(command.named)
        outcome = server.run(
            command.words,
            cwd=self.here,
            tmp=self.tmp,
            write=command.named,
            hostile=[self.root],
            environ={"HOME": str(self.home), **command.environ},
        )
        changed = sorted(
            str(path)
            for path, _ in before.items() ^ self._seen(command.named).items()
            if "__pycache__" not in str(path)
        )
        left = [str(path) for path in self.tmp.rglob("*ESC*")]
        return outcome, [*_faults(outcome, command), *(f"changed outside: {each}" for each in {*changed, *left})]

    def _seen(self, named):
        """Everything that the command may not change: path -> kind, size, time and content."""
        allowed = {self.tmp, *(Path(each) for each in named)}
        found, open_ones = {}, [self.root]
        while open_ones:
            for entry in os.scandir(open_ones.pop()):
                path, about = Path(entry.path), entry.stat(follow_symlinks=False)
                if path in allowed:
                    continue
                if stat.S_ISDIR(about.st_mode):
                    found[path] = (about.st_mode,)
                    open_ones.append(path)
                    continue
                small = stat.S_ISREG(about.st_mode) and about.st_size < 1_000_000
                content = hashlib.sha256(path.read_bytes()).hexdigest() if small else ""
                found[path] = about.st_mode, about.st_size, about.st_mtime_ns, content
        return found


def _faults(outcome, command):
    """Return what is wrong with a command, whatever it has changed."""
    found = [f"stopped: {each}" for each in outcome.stopped]
    text = outcome.out + outcome.err
    if outcome.stopped:
        return found
    if TRACE in text or outcome.code == 70:
        last = [line for line in outcome.err.splitlines() if line.strip()][-2:]
        found.append(f"traceback: {' / '.join(last)[:300]}")
    elif outcome.code not in command.codes:
        found.append(f"exit code {outcome.code}, not one of {command.codes}: {outcome.err.strip()[-300:]!r}")
    if outcome.code == 2 and not outcome.err.strip():
        found.append("refused without a sentence")
    strange = sorted({each for each in text if each not in "\n\t\r" and not _is_plain(each)})
    if strange:
        found.append(f"prints {strange}")
    if outcome.seconds > SECONDS or outcome.waited > PATIENCE:
        found.append(f"takes {outcome.seconds:.1f} s of the processor, {outcome.waited:.1f} s on the clock")
    if outcome.mb > MEMORY:
        found.append(f"takes {outcome.mb:.0f} MB")
    return found


def _is_plain(character):
    """Whether a terminal shows a character, and the ones after it in their order."""
    number = ord(character)
    control = number < 32 or 127 <= number < 160
    return not (control or 0x200E <= number <= 0x200F or 0x202A <= number <= 0x202E or 0x2066 <= number <= 0x2069)


def verify(archive, *, refused=False, note="", environ=None):
    """Return the ways to verify an archive."""
    codes = (2,) if refused else (0, 1, 2)
    ways = (("--no-run",), ("--runs", 2, "-j", 1), ("-j", 1))
    named = (archive.parent,)
    return [Command(("verify", archive, *way), named, codes, environ or {}, note) for way in ways]


def check(config, *, refused=False, note="", environ=None, allow=()):
    """Return the commands that read a configuration and compute nothing."""
    codes = (2,) if refused else (0, 1, 2)
    words = [("check", config), ("run", "-n", config)]
    return [Command((*each, *allow), (), codes, environ or {}, note) for each in words]


def each_of(box, place, verbs="report status compare pack show sites", *, refused=(), note="", name="plain"):
    """Return commands that take a directory of results.

    Parameters
    ----------
    place : the directory
    verbs : of these commands
    refused : those that must end with 2
    name : of the honest results that were altered
    """
    from received.honest import METHOD

    other, out = box.honest.directory("tuned" if name != "tuned" else "plain"), box.here / "out"
    words = {
        "report": (("report", place), (place,)),
        "status": (("status", place), (place,)),
        "json": (("status", place, "--json"), (place,)),
        "compare": (("compare", place, other), (place, other)),
        "pack": (("pack", place, "-o", out / "packed.zip"), (place, out)),
        "show": (("show", place, "--run", 0, "--method", METHOD[name]), (place,)),
        "merge": (("merge", place), (place,)),
        "sites": (("report", place, other, "--to", out), (place, other, out)),
    }
    out.mkdir(exist_ok=True)
    for verb in verbs.split():
        given, named = words[verb]
        yield Command(given, named, (2,) if verb in refused else (0, 1, 2), {}, note)


def git(directory, *words):
    """Call git for a test, without the settings of the user."""
    environment = {**os.environ, "GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull}
    options = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "init.defaultBranch=main"]
    subprocess.run(["git", "-C", directory, *options, *words], check=True, capture_output=True, env=environment)
