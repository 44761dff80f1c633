"""What may execute: files with code, modules that a configuration names, and git.

The user who names a configuration agrees to the files with code in its directory and below.  Everything else needs
`--allow-code`.  An archive needs it for every file.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import site
import stat
import subprocess
import sys
import zipfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from importlib.metadata import distributions, packages_distributions
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import unquote, urlparse

from rmpc_bench.received.plain_files import text_of

NO_CODE = "RMPC_BENCH_NO_CODE"  # environment variable that refuses everything that could execute when it is 1
ENDINGS = (".py", ".pyc", ".pyw", ".pyd", ".so", ".dll", ".dylib", ".pth", ".fmu")
_STARTS = (b"\x7fELF", b"MZ", b"#!", b"\xca\xfe\xba\xbe", b"\xfe\xed\xfa", b"\xce\xfa\xed\xfe", b"\xcf\xfa\xed\xfe")
"""First bytes of programs and libraries of Linux, Windows and macOS, and of scripts."""
VERIFIED = "verified_on.json"
"""The file to which every verification of an archive appends a record; its directory came from elsewhere."""
UNKNOWN = {"commit": "unknown"}
_GIT_SECONDS = 10
_LONGEST = 1000  # largest size of a file that names a commit [bytes]

accepted: set[Path] = set()  # files with code that this process has named on stderr


def is_code(path: Path) -> bool:
    """Whether a file can execute: by its ending, its first bytes, or as a zip archive of anything but arrays.

    A file may be an archive and text at once, and an FMU is taken out whatever its ending and its entries are.
    """
    if path.suffix.lower() in ENDINGS:
        return True
    try:
        with path.open("rb") as file:
            if file.read(4).startswith(_STARTS):
                return True
        with zipfile.ZipFile(path) as archive:
            return not all(name.endswith(".npy") for name in archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False
    except (ValueError, NotImplementedError):
        return True


def refused(name: str) -> str:
    """Say that nothing may execute; empty where the environment does not forbid it."""
    what = "Python files" if name.endswith(".py") else "files with code"
    return f"{name}: {what} are not loaded, because {NO_CODE}=1 is set" if os.environ.get(NO_CODE) == "1" else ""


def reason_against(path: Path, name: str, roots: Collection[Path]) -> str:
    """Say why a file with code, whose links are resolved, may not be loaded, and the way out; empty where it may.

    `roots` are files and directories to which somebody has agreed; none for a configuration that is no regular file.
    """
    if reason := refused(name):
        return reason
    if not roots:
        return f"{name}: a configuration that is no file in a directory may load no Python file"
    if any(path.is_relative_to(root) for root in roots):
        return ""
    relative = os.path.relpath(path)
    shown = shlex.quote(relative if len(relative) < len(str(path)) else str(path))
    text = f"{name} is outside the directory of the configuration; its code runs only if you allow it"
    return f"{text}: --allow-code {shown}"


def reason_against_archive(archive: Path, files: Mapping[str, str], allowed: Iterable[str | Path]) -> str:
    """Say why the files with code of an archive, with their hashes, may not run, and the way out; empty if they may."""
    here = archive.resolve()
    if reason := refused(next(iter(files), "")):
        return f"{archive}: {reason}" if files else ""
    if not files or any(here.is_relative_to(Path(each).resolve()) for each in allowed):
        return ""
    listed = ", ".join([f"{name} (sha {sha[:6]})" for name, sha in files.items()][:10])
    name = shlex.quote(str(archive))
    return (
        f"{archive}: has files with code: {listed}{', ..' * (len(files) > 10)}\n"
        f"to let them run: rmpc-bench verify {name} --allow-code {name}\n"
        f"to check the files without running anything: rmpc-bench verify {name} --no-run"
    )


def reason_against_module(text: str) -> str:
    """Say why a module that a value names, as in ``module:Name-v0``, may not be imported; empty where it may."""
    module, colon, _ = text.partition(":")
    steps = module.split(".")
    if not colon or not all(each.isidentifier() for each in steps):
        return ""
    if reason := refused(text):
        return reason
    if not any(each.startswith("__") for each in steps) and _is_installed(steps[0]):
        return ""
    return (
        f"{text}: the module {module} belongs to no installed distribution and is no file under `plugins`, so that it "
        "is not imported; install it, or name the class that it registers, PATH.py:NAME"
    )


def _is_installed(name: str) -> bool:
    """Whether a module belongs to a distribution, editable or not, or is a file that was named on stderr."""
    if name in sys.stdlib_module_names or name == __name__.partition(".")[0]:
        return False
    try:
        spec = find_spec(name)
    except (ImportError, ValueError):
        return False
    if spec is None:
        return False
    inside = [*(spec.submodule_search_locations or ()), *([spec.origin] if spec.has_location and spec.origin else [])]
    places = [Path(each).resolve() for each in inside]
    if not places or places[0] in accepted:
        return bool(places)
    named = [each for each in sys.path if Path(each).name in ("site-packages", "dist-packages")]
    sites = [Path(each).resolve() for each in (*site.getsitepackages(), site.getusersitepackages(), *named)]
    if places[0].parent in sites:
        return name in packages_distributions()
    return any(places[0].is_relative_to(root) for root in _editable_roots(map(str, sites)))


def _editable_roots(sites: Iterable[str]) -> Iterator[Path]:
    """Yield the directories of the distributions that are installed as editable."""
    for each in distributions(path=[*sites]):
        try:
            found = json.loads(each.read_text("direct_url.json") or "{}")
        except ValueError:
            continue
        if found.get("dir_info", {}).get("editable"):
            yield Path(unquote(urlparse(found["url"]).path)).resolve()


def commit_of(directory: Path) -> dict[str, Any] | None:
    """Return the commit of the repository of a directory, and whether there are uncommitted changes; None without one.

    It is ``unknown`` in an archive that was taken out, and where nothing may execute.  No setting of the repository has
    an effect: git works in an empty repository of its own, which reads only the objects and a copy of the index of the
    other one.  So it has no hooks, filters, monitors or aliases.
    """
    start = directory.resolve()
    for top in (start, *start.parents):
        if (top / VERIFIED).exists() or os.environ.get(NO_CODE) == "1":
            return UNKNOWN
        if os.path.lexists(top / ".git"):
            about = (top / ".git").lstat()
            # A file, a link, and a directory of another user lead elsewhere.
            return _commit(top) if stat.S_ISDIR(about.st_mode) and about.st_uid == os.getuid() else UNKNOWN
    return None


def _commit(top: Path) -> dict[str, Any] | None:
    """Ask git about the working tree at the top of a repository; None where it does not answer."""
    paths = [each for each in os.get_exec_path() if os.path.isabs(each)]
    program, there = shutil.which("git", path=os.pathsep.join(paths)), top / ".git"
    head = _head(there)
    if program is None or not head:
        return None
    with TemporaryDirectory(prefix="rmpc-bench-git") as temporary:
        own = Path(temporary)
        for name in ("objects", "refs"):
            (own / name).mkdir()
        (own / "HEAD").write_text(f"{head}\n", encoding="ascii")
        environment = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
        environment |= {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}
        environment |= {"GIT_OBJECT_DIRECTORY": str(there / "objects"), "GIT_OPTIONAL_LOCKS": "0"}
        environment |= {"GIT_CEILING_DIRECTORIES": temporary, "GIT_TERMINAL_PROMPT": "0", "GIT_ATTR_NOSYSTEM": "1"}
        off = [f"core.excludesFile={there / 'info' / 'exclude'}", "core.fsmonitor=false", "protocol.allow=never"]
        options = [word for each in (*off, f"core.hooksPath={os.devnull}") for word in ("-c", each)]
        command = [program, "--no-pager", f"--git-dir={own}", f"--work-tree={top}", *options]
        command += ["status", "--porcelain", "--ignore-submodules=all", "--no-renames"]
        try:
            if (there / "index").is_file():
                shutil.copy(there / "index", own / "index")
            done = subprocess.run(
                command, cwd=top, env=environment, stdin=subprocess.DEVNULL, capture_output=True, timeout=_GIT_SECONDS
            )
        except (OSError, subprocess.SubprocessError):
            return None
    return {"commit": head, "dirty": bool(done.stdout)} if done.returncode == 0 else None


def _head(there: Path) -> str:
    """Return the commit of HEAD from the files of a repository; empty where they do not have it."""
    try:
        text = text_of(there / "HEAD", _LONGEST).strip()
        name = text.removeprefix("ref: ")
        if name != text and name.startswith("refs/") and ".." not in name:
            if (there / name).exists():
                text = text_of(there / name, _LONGEST).strip()
            else:
                packed = (line.partition(" ") for line in text_of(there / "packed-refs").splitlines())
                text = next((commit for commit, _, of in packed if of == name), "")
    except (OSError, ValueError):
        return ""
    return text if re.fullmatch("[0-9a-f]{40}", text) else ""
