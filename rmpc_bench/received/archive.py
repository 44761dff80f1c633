"""An archive of packed results: which of its files are taken out, where, and with which hashes.

An archive may come from somebody else.  Nothing is taken out before all of its names and sizes are checked: a name
stays inside the directory, no entry is a symbolic link, and the content is limited.
"""

from __future__ import annotations

import hashlib
import json
import re
import stat
import struct
import unicodedata
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from rmpc_bench.received.consent import VERIFIED, is_code
from rmpc_bench.received.plain_files import checked
from rmpc_bench.replaced_file import replaced

METADATA = "ro-crate-metadata.json"
DATE = (1980, 1, 1, 0, 0, 0)  # date of every entry, so that equal results give equal archives
MOST_ENTRIES = 20_000
MOST_METADATA = 10_000_000  # largest size of a file that is read as JSON [bytes]
LONGEST_NAME = 500
DEEPEST_NAME = 20  # directories, one in the other, and the file in them
MOST_BYTES = 8_000_000_000
MOST_EXPANSION = 30
"""Largest ratio of content to archive, for archives with more than `ALWAYS_ALLOWED` bytes of content."""
ALWAYS_ALLOWED = 100_000_000
_OF_GIT = re.compile(r"(\.git|git~\d+)[. ]*", re.IGNORECASE)
"""Names of the directory of git, as other systems than Linux understand them, too."""
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, struct.error)
"""Errors of the library zipfile for a file that is no proper archive."""
_FILE = 0o644 << 16
_BLOCK = 1 << 20


class ArchiveError(Exception):
    """A file that is no archive of results, or whose content may not be taken out."""


@dataclass(frozen=True)
class Archive:
    """A checked archive."""

    path: Path
    names: tuple[str, ...]  # names of its files
    hashes: Mapping[str, str]  # file -> SHA-256 of its content, as the metadata states it

    def code(self, directory: Path) -> dict[str, str]:
        """Return the files that can execute, with their stated hashes, after they were taken out into a directory."""
        return {name: self.hashes.get(name, "unknown") for name in self.names if is_code(directory / name)}

    def extract(self, directory: Path) -> tuple[str, ...]:
        """Write all files into a directory and compare their hashes with the metadata."""
        found: dict[str, str] = {}
        with _opened(self.path) as file:
            for name in self.names:
                target = directory / name
                target.parent.mkdir(parents=True, exist_ok=True)
                found[name] = _copy(file, name, target)
        changed = [
            f"{name}: its content is not what was packed"
            for name, digest in self.hashes.items()
            if name in found and found[name] != digest
        ]
        missing = [f"{name}: is missing" for name in self.hashes.keys() - found.keys()]
        added = [f"{name}: was not packed" for name in found.keys() - self.hashes.keys() - {METADATA, VERIFIED}]
        return tuple(sorted([*changed, *missing, *added]))


def open_archive(path: Path) -> Archive:
    """Check an archive; nothing is taken out."""
    with _opened(path) as file:
        names = _checked_names(file, path)
        if METADATA not in names:
            raise ArchiveError(f"{path}: there is no {METADATA}; make archives with `rmpc-bench pack`")
        hashes = _hashes(_json(file, path, METADATA), path)
    verifications(path)
    return Archive(path, tuple(names), hashes)


def write_archive(path: Path, contents: Mapping[str, Path | bytes]) -> None:
    """Write an archive; equal contents give equal bytes."""
    for name in contents:
        reason = _reason_against(_entry(name))
        if reason:
            raise ArchiveError(f"{path}: the file {name!r} {reason}; rename the method or figure that it belongs to")
    with replaced(path) as partial:
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as file:
            for name in sorted(contents, key=lambda each: (each != METADATA, each)):
                with file.open(_entry(name), "w", force_zip64=True) as target:
                    for block in _blocks(contents[name]):
                        target.write(block)
        # What `verify` does not take out is not packed.
        open_archive(partial)


def verifications(path: Path) -> list[dict[str, Any]]:
    """Return the records of the verifications of an archive, in the order of time."""
    with _opened(path) as file:
        if VERIFIED not in file.namelist():
            return []
        records = _json(file, path, VERIFIED)
    return [each for each in records if isinstance(each, dict)] if isinstance(records, list) else []


def note_verification(path: Path, record: Mapping[str, Any]) -> None:
    """Append a record to the verifications of an archive, which is replaced as a whole; all other files stay."""
    records = [*verifications(path), dict(record)]
    with _opened(path) as file, replaced(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as new:
        for entry in file.infolist():
            if entry.filename != VERIFIED:
                with new.open(_entry(entry.filename), "w", force_zip64=True) as target:
                    target.writelines(_unpacked(file, entry.filename))
        new.writestr(_entry(VERIFIED), json_bytes(records))


def json_bytes(data: Any) -> bytes:
    """Write plain data as JSON."""
    return (json.dumps(data, indent=2, ensure_ascii=False) + "\n").encode()


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, DATE)
    entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, _FILE
    entry.create_system = 3
    return entry


def _blocks(content: Path | bytes) -> Iterator[bytes]:
    if isinstance(content, bytes):
        yield content
        return
    with content.open("rb") as file:
        while block := file.read(_BLOCK):
            yield block


def _opened(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except OSError as error:
        raise ArchiveError(f"{path}: cannot be read ({error.strerror or error})") from None
    except _DAMAGED as error:
        raise ArchiveError(f"{path}: is not a zip archive ({error})") from None


def _checked_names(file: zipfile.ZipFile, path: Path) -> list[str]:
    """Return the names of all files of an archive."""
    entries = file.infolist()
    if len(entries) > MOST_ENTRIES:
        raise ArchiveError(f"{path}: has {len(entries)} entries, more than {MOST_ENTRIES}")
    for entry in entries:
        reason = _reason_against(entry)
        if reason:
            raise ArchiveError(f"{path}: the entry {entry.filename[:200]!r} {reason}; nothing was taken out")
    names = [entry.filename for entry in entries if not entry.is_dir()]
    known = {unicodedata.normalize("NFD", unicodedata.normalize("NFD", name).casefold()) for name in names}
    # Not every system distinguishes capital letters, or an accent from the letter with it.
    if len(known) < len(names):
        raise ArchiveError(f"{path}: has two entries of one name; nothing was taken out")
    if clash := {str(above) for name in known for above in PurePosixPath(name).parents} & known:
        raise ArchiveError(f"{path}: {min(clash)[:200]!r} is a file and a directory; nothing was taken out")
    size, packed = sum(entry.file_size for entry in entries), path.stat().st_size
    if size > min(MOST_BYTES, max(ALWAYS_ALLOWED, MOST_EXPANSION * packed)):
        raise ArchiveError(f"{path}: would fill {size / 1e6:.0f} MB from {packed / 1e6:.1f} MB; nothing was taken out")
    return names


def _reason_against(entry: zipfile.ZipInfo) -> str:
    """Say why an entry is not taken out; empty where nothing is wrong."""
    # `orig_filename` is the name as it stands in the archive; a zero byte would end it early.
    name = entry.orig_filename
    if len(name.encode()) > LONGEST_NAME or name.count("/") > DEEPEST_NAME:
        return f"has a name of more than {LONGEST_NAME} bytes or {DEEPEST_NAME} directories"
    path = PurePosixPath(name)
    if any(character in name for character in "\\:\0") or not name.isprintable():
        return "has a name that not every system accepts"
    if path.is_absolute() or ".." in path.parts or not path.parts or path.as_posix() != name.rstrip("/"):
        return "has a name that leads out of the directory or is not plain"
    if any(len(part.encode()) > 200 for part in path.parts):
        return "has too long a name"
    if entry.is_dir() and entry.file_size:
        return "is a directory with content"
    if any(_OF_GIT.fullmatch(part) for part in path.parts):
        return "belongs to a git repository, whose settings can run commands"
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        return "is compressed by another method than deflate"
    mode = entry.external_attr >> 16
    if mode and not (stat.S_ISREG(mode) or stat.S_ISDIR(mode) or stat.S_IFMT(mode) == 0):
        return "is no regular file"
    return "is encrypted" if entry.flag_bits & 1 else ""


def _unpacked(file: zipfile.ZipFile, name: str) -> Iterator[bytes]:
    """Yield the content of an entry; an error of the one who takes it, such as a full disk, stays what it is."""
    try:
        with file.open(name) as source:
            while block := source.read(_BLOCK):
                yield block
    except (*_DAMAGED, OSError) as error:
        raise ArchiveError(f"{file.filename}: {name}: cannot be read ({error})") from None


def _copy(file: zipfile.ZipFile, name: str, target: Path) -> str:
    """Write an entry into a file, not more than its stated size, and return the SHA-256 of its content."""
    digest, left = hashlib.sha256(), file.getinfo(name).file_size
    with target.open("xb") as written:
        for block in _unpacked(file, name):
            left -= len(block)
            if left < 0:
                raise ArchiveError(f"{file.filename}: the entry {name!r} is longer than it states")
            digest.update(block)
            written.write(block)
    return digest.hexdigest()


def _json(file: zipfile.ZipFile, path: Path, name: str) -> Any:
    """Read an entry of limited size as JSON."""
    if file.getinfo(name).file_size > MOST_METADATA:
        raise ArchiveError(f"{path}: {name}: is larger than {MOST_METADATA / 1e6:g} MB")
    content = b"".join(_unpacked(file, name))
    try:
        return checked(content, (dict, list), any_text=True)
    except ValueError as error:
        raise ArchiveError(f"{path}: {name}: {error}") from None


def _hashes(metadata: Any, path: Path) -> dict[str, str]:
    """Return file -> SHA-256 from the entities of an RO-Crate; anything but plain names and hashes is refused."""
    graph = metadata.get("@graph") if isinstance(metadata, dict) else None
    entities = [each for each in graph if isinstance(each, dict)] if isinstance(graph, list) else []
    found: dict[str, str] = {}
    for entity in entities:
        if "sha256" not in entity:
            continue
        name, digest = entity.get("@id"), entity["sha256"]
        if not isinstance(name, str) or not name or _reason_against(_entry(name)) or name in found:
            raise ArchiveError(f"{path}: {METADATA}: '@id' must be the name of one file (got {str(name)[:100]!r})")
        if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
            raise ArchiveError(f"{path}: {METADATA}: 'sha256' of {name!r} must have 64 hexadecimal digits")
        found[name] = digest
    if not found:
        raise ArchiveError(f"{path}: {METADATA} names no file with its hash; make archives with `rmpc-bench pack`")
    return found
