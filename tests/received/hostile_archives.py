"""Archives for `verify` that somebody has made to harm the reader: names, links and directories of git."""

import hashlib
import json
import stat
import struct
import warnings
import zipfile

import packed
from received.box import Case, check, git, verify

METADATA = "ro-crate-metadata.json"


def archive(box, changes=None, *, base="plain", entries=(), raw=None, file="x.zip"):
    """Write an altered copy of an honest archive, every hash in its metadata that of the altered content.

    Parameters
    ----------
    changes : name -> content, or None for a file that goes
    entries : further entries with their contents, in any form
    raw : bytes of the archive to replace, of equal length
    """
    found = packed.contents(box.honest.archive(base)) | (changes or {})
    found = {name: content for name, content in found.items() if content is not None}
    if METADATA not in (changes or {}):
        metadata = json.loads(found[METADATA])
        known = {each["@id"]: each for each in metadata["@graph"] if "sha256" in each}
        for name, content in [*found.items(), *((entry.filename, content) for entry, content in entries)]:
            if name not in (METADATA, "verified_on.json"):
                entity = known.setdefault(name, {"@id": name, "@type": "File"})
                entity["sha256"] = hashlib.sha256(content).hexdigest()
                entity["contentSize"] = str(len(content))
        kept = [each for each in metadata["@graph"] if "sha256" not in each]
        gone = set(known) - set(found) - {entry.filename for entry, _ in entries}
        metadata["@graph"] = kept + [each for name, each in known.items() if name not in gone]
        found[METADATA] = json.dumps(metadata, ensure_ascii=True).encode()
    path = box.here / file
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
        warnings.simplefilter("ignore")  # of names that are given twice
        for name, content in found.items():
            target.writestr(name, content)
        for entry, content in entries:
            target.writestr(entry, content)
    if raw:
        content = path.read_bytes()
        for before, after in raw.items():
            assert len(before) == len(after) and before in content
            content = content.replace(before, after)
        path.write_bytes(content)
    return path


def entry(name, mode=0o100644, system=3, extra=b""):
    """An entry with any name and mode."""
    info = zipfile.ZipInfo("x")
    info.filename, info.external_attr, info.create_system, info.extra = name, mode << 16, system, extra
    info.compress_type = zipfile.ZIP_DEFLATED
    return info


NAMES = {
    "parent": "../ESC",
    "grandparent": "../../../../ESC",
    "parent-inside": "figures/../../ESC",
    "absolute": "{outside}/ESC",
    "two-slashes": "//ESC",
    "backslash": "..\\ESC",
    "backslash-inside": "figures\\..\\..\\ESC",
    "drive": "C:ESC",
    "drive-slash": "C:/ESC",
    "drive-backslash": "C:\\ESC",
    "share": "\\\\host\\share\\ESC",
    "long": "a" * 5000,
    "deep": "d/" * 2000 + "ESC",
    "dot": "./ESC",
    "only-dots": "..",
    "empty-part": "a//ESC",
    "newline": "a\nb",
    "escape": "\x1b]0;pwn\x07.csv",
    "direction": "a\u202evsc.csv",
    "stream": "trials.csv:stream",
}
"""Names that are refused before a byte is written."""
HARMLESS = {
    "home": "~/ESC",
    "variable": "$HOME/ESC",
    "percent": "%2e%2e/ESC",
    "device": "CON",
    "case": "Trials.CSV",
    "last-dot": "trials.csv.",
    "last-blank": "trials.csv ",
    "case-of-folder": "FIGURES/x.csv",
}
"""Names that lead nowhere; some systems confuse them with others."""
RAW = {
    "nul": (b"a_NUL_b", b"a\0../ES"),
    "not-utf8": (b"figXres", b"\xc0\xae\xc0\xae/ES"[:7]),
    "latin": (b"figXres", b"fig\xffres"),
}
"""Bytes of names that no program for archives writes."""


def _named(name, *, refused):
    def make(box):
        text = name.format(outside=box.outside) if "{outside}" in name else name
        yield from verify(archive(box, entries=[(entry(text), b"x")]), refused=refused)

    return make


def _raw(before, after):
    def make(box):
        yield from verify(archive(box, entries=[(entry(before.decode()), b"x")], raw={before: after}))

    return make


def _twice(box):
    yield from verify(archive(box, entries=[(entry("trials.csv"), b"other")]), refused=True)


def _file_and_directory(box):
    yield from verify(archive(box, entries=[(entry("a"), b"x"), (entry("a/b"), b"x")]), refused=True)


def _local_name(box):
    """The local header has another name than the directory of the archive."""
    path = archive(box, entries=[(entry("figures/zzz.csv"), b"x")])
    content = path.read_bytes()
    at = content.find(b"figures/zzz.csv")
    path.write_bytes(content[:at] + b"../../../ESC.cs"[:15] + content[at + 15 :])
    yield from verify(path, refused=True)


def _unicode_field(box):
    """A field of Info-ZIP gives another name."""
    name = b"../ESC"
    field = struct.pack("<HHBL", 0x7075, 5 + len(name), 1, 0) + name
    yield from verify(archive(box, entries=[(entry("figures/a.csv", extra=field), b"x")]))


def _link(mode, content, *, then="", system=3, refused=True):
    def make(box):
        text = content.format(outside=box.outside).encode()
        entries = [(entry("figures/link", mode, system), text)]
        entries += [(entry(f"figures/link/{then}"), b"x")] if then else []
        yield from verify(archive(box, entries=entries), refused=refused)

    return make


def _link_in_place(box):
    """The trials are a link to a file of the reader."""
    text = str(box.outside / "precious").encode()
    yield from verify(archive(box, {"trials.csv": None}, entries=[(entry("trials.csv", 0o120777), text)]), refused=True)


def _shared_bytes(box):
    """Two entries have one content, as hard links."""
    path = archive(box, {"a.csv": b"1\n" * 100, "b.csv": b"1\n" * 100})
    with zipfile.ZipFile(path) as file:
        first, second = (file.getinfo(each).header_offset for each in ("a.csv", "b.csv"))
    content = path.read_bytes()
    at = content.rfind(b"b.csv") - 4
    assert content[at : at + 4] == struct.pack("<L", second)
    path.write_bytes(content[:at] + struct.pack("<L", first) + content[at + 4 :])
    yield from verify(path)


LINKS = {
    "symbolic": _link(0o120777, "{outside}/precious"),
    "symbolic-relative": _link(0o120777, "../../../../outside/precious"),
    "through-a-link": _link(0o120777, "{outside}/elsewhere", then="ESC"),
    "link-of-dos": _link(0o120777, "{outside}/precious", system=0, refused=False),
    "pipe": _link(stat.S_IFIFO | 0o644, ""),
    "device": _link(stat.S_IFCHR | 0o644, ""),
    "socket": _link(stat.S_IFSOCK | 0o644, ""),
    "user-of-the-file": _link(stat.S_IFREG | 0o6755, "#!/bin/sh\n", refused=False),
    "in-place": _link_in_place,
    "shared-bytes": _shared_bytes,
}


def repository(box, top):
    """Make a repository with a commit, so that git has something to compare; return its directory `.git`."""
    git(top, "init", "-q")
    (top / "tracked.csv").write_text("1\n", encoding="utf-8")
    git(top, "add", "tracked.csv")
    git(top, "commit", "-q", "-m", "a")
    (top / "tracked.csv").write_text("2\n", encoding="utf-8")
    return top / ".git"


def monitor(box):
    """Settings with a command that `git status` starts."""
    return f'[core]\n\trepositoryformatversion = 0\n\tbare = false\n\tfsmonitor = "{box.shell}; false"\n'


def _with_git(folder, name=".git", *, refused=True, only=()):
    """Pack a repository with a monitor; `only` are the files of it that are packed."""

    def make(box):
        made = box.outside / "made"
        made.mkdir()
        there = repository(box, made)
        (there / "config").write_text(monitor(box), encoding="utf-8")
        entries = []
        for path in sorted(there.rglob("*")):
            inside = path.relative_to(there).as_posix()
            if path.is_file() and "hooks" not in inside and (not only or inside in only):
                place = f"{folder}{name}/{inside}" if name else f"{folder}{inside}"
                entries.append((entry(place), path.read_bytes()))
        yield from verify(archive(box, entries=entries), refused=refused)

    return make


def _git_file(box):
    """A file `.git` names a repository elsewhere in the archive."""
    yield from verify(archive(box, {"code/.git": b"gitdir: ../data\n", ".git": b"gitdir: data\n"}), refused=True)


def _beside(box):
    """The archive lies in a repository of somebody else."""
    (repository(box, box.here) / "config").write_text(monitor(box), encoding="utf-8")
    yield from verify(archive(box))
    yield from check(box.honest.config("plain"))


def _settings(box):
    """Files that git reads in a working tree."""
    names = {".gitattributes": b"* filter=evil diff=evil\n", ".gitmodules": b'[submodule "x"]\n\turl = -u./x\n'}
    names |= {".gitconfig": monitor(box).encode(), ".hg/hgrc": f"[hooks]\nupdate = {box.shell}\n".encode()}
    yield from verify(archive(box, names))


GIT = {
    "directory": _with_git(""),
    "upper-case": _with_git("", ".GIT"),
    "mixed-case": _with_git("", ".Git"),
    "short-name": _with_git("", "git~1"),
    "last-dot": _with_git("", ".git."),
    "last-blank": _with_git("", ".git "),
    "invisible": _with_git("", ".g\u200cit"),
    "stream": _with_git("", ".git::$INDEX_ALLOCATION"),
    "in-code": _with_git("code/"),
    "in-data": _with_git("data/0/"),
    "config-alone": _with_git("", only=("config", "HEAD")),
    "bare": _with_git("", "", refused=False),
    "bare-in-folder": _with_git("tables/", "", refused=False),
    "file": _git_file,
    "around-the-archive": _beside,
    "settings": _settings,
}
OTHERS = {
    "twice": _twice,
    "file-and-directory": _file_and_directory,
    "local-name": _local_name,
    "unicode-field": _unicode_field,
}
CASES = [
    *(Case("archive-name", name, _named(text, refused=True)) for name, text in NAMES.items()),
    *(Case("archive-name", name, _named(text, refused=False)) for name, text in HARMLESS.items()),
    *(Case("archive-name", name, _raw(*bytes_)) for name, bytes_ in RAW.items()),
    *(Case("archive-name", name, make) for name, make in OTHERS.items()),
    *(Case("archive-link", name, make) for name, make in LINKS.items()),
    *(Case("archive-git", name, make) for name, make in GIT.items()),
]
