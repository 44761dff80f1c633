"""Directories of results that somebody has made to harm the reader: links, repositories, altered copies."""

import json
import os
import shutil

import small_experiment
from received.box import Case, Command, check, each_of, git
from received.hostile_archives import monitor, repository
from received.hostile_configs import ESTIMATOR, NO_CODE, lay, pickled

LINKED = (74, 2, 1, 0)
"""A file or directory that cannot be written ends with 74."""


def with_links(commands):
    """Allow that the results cannot be written where a link is in their place."""
    for command in commands:
        yield command._replace(codes=LINKED)


def _file_links(names, verbs, make):
    """A file of the results is a link to one of the reader, or to one that is not there yet."""

    def cases(box):
        place = box.results()
        for name in names:
            if (place / name).exists():
                (place / name).unlink()
            (place / name).parent.mkdir(exist_ok=True)
            make(place / name, box)
        yield from with_links(each_of(box, place, verbs))

    return cases


def _symbolic(path, box):
    path.symlink_to(box.outside / "precious")


def _dangling(path, box):
    path.symlink_to(box.outside / "ESC")


def _hard(path, box):
    os.link(box.outside / "precious", path)


def _pipe(path, box):
    os.mkfifo(path)


def _device(path, box):
    path.symlink_to("/dev/zero")


def _loop(path, box):
    path.symlink_to(path.name)


DERIVED = (
    "trials.csv",
    "report.html",
    "report.md",
    "series.csv",
    "summary.csv",
    "claims.md",
    "tables/mse.tex",
    "CITATION.cff",
)
RECORDS = ("manifest.json", "progress.json", "published.json", "claims.json", "tuning.json")
CONFIGS = ("config.yaml", "config.resolved.yaml")
STORE = ("trials.sqlite",)
WAYS = {"symbolic": _symbolic, "dangling": _dangling, "hard": _hard, "pipe": _pipe, "device": _device, "loop": _loop}
PARTS = {
    "derived": (DERIVED, "report pack"),
    "records": (RECORDS, "report status pack"),
    "configs": (CONFIGS, "report show"),
    "store": (STORE, "compare pack show"),
}
"""Files of the results, and the commands that read or write them."""


def _folder_links(name, to):
    def cases(box):
        place = box.results("owned" if name == "code" else "shards" if name == "shards" else "plain")
        if (place / name).exists():
            shutil.copytree(place / name, box.outside / "elsewhere", dirs_exist_ok=True)
            shutil.rmtree(place / name)
        (place / name).symlink_to(to.format(outside=box.outside))
        base = place.name
        verbs = "status merge report" if name == "shards" else "report status compare pack"
        yield from with_links(each_of(box, place, verbs, name=base))

    return cases


def _whole_link(box):
    """The directory itself is a link: the user has named it, and its files are those of the user."""
    there = box.results()
    (box.here / "link").symlink_to(there)
    for command in each_of(box, box.here / "link", "report status"):
        yield command._replace(named=(*command.named, there))


def _out_has_links(box):
    """The place for pages holds a link."""
    place, out = box.results(), box.here / "out"
    (out / "tiny").parent.mkdir()
    (out / "tiny").symlink_to(box.outside / "elsewhere")
    (out / "index.html").symlink_to(box.outside / "precious")
    yield from with_links(each_of(box, place, "sites"))


FOLDERS = {
    "tables": "{outside}/elsewhere",
    "figures": "../../outside/elsewhere",
    "failures": "{outside}/elsewhere",
    "code": "{outside}/elsewhere",
    "logs": "{outside}/elsewhere",
    "shards": "{outside}/elsewhere",
    "tuning": "{outside}/elsewhere",
}


def in_repository(alter):
    """Results and a configuration lie in a repository of somebody else; every command that asks git is called."""

    def cases(box):
        place, config = box.results(), small_experiment.write(box.here)
        alter(box, repository(box, box.here))
        out = box.here / "computed"
        options = ("-o", out, "-j", 1, "--no-report", "--progress", "none")
        yield Command(("run", config, *options), (out,), (0,))
        yield from check(config)
        yield from each_of(box, place, "pack")

    return cases


def _monitor(box, there):
    (there / "config").write_text(monitor(box), encoding="utf-8")


def _settings(text):
    def alter(box, there):
        given = text.format(shell=box.shell, here=box.here, outside=box.outside)
        (there / "config").write_text((there / "config").read_text() + given, encoding="utf-8")
        (box.here / ".gitattributes").write_text("* filter=evil diff=evil merge=evil\n", encoding="utf-8")
        (box.here / "evil.cfg").write_text(monitor(box), encoding="utf-8")

    return alter


def _hooks(box, there):
    folder = box.here / "hooks"
    for place in (folder, there / "hooks"):
        place.mkdir(exist_ok=True)
        for name in ("post-index-change", "fsmonitor-watchman", "pre-commit", "reference-transaction"):
            (place / name).write_text(f"#!/bin/sh\n{box.shell}\n", encoding="utf-8")
            (place / name).chmod(0o755)
    _settings('\n[core]\n\thooksPath = "{here}/hooks"\n\tfsmonitor = .git/hooks/fsmonitor-watchman\n')(box, there)


def _moved(name, text):
    """The repository lies elsewhere; `.git` is a file or a link that names it."""

    def alter(box, there):
        _monitor(box, there)
        there.rename(box.here / name)
        if text is None:
            there.symlink_to(box.here / name)
        elif text:
            there.write_text(text.format(here=box.here), encoding="utf-8")

    return alter


def _bare(box, there):
    """A directory that is a repository itself."""
    _monitor(box, there)
    for path in there.iterdir():
        path.rename(box.here / path.name)
    there.rmdir()
    (box.here / "config").write_text(monitor(box).replace("bare = false", "bare = true"), encoding="utf-8")


def _inside_results(box, there):
    """The repository is the directory of the results, as one file of many."""
    _monitor(box, there)
    there.rename(box.here / "plain" / ".git")


def _submodule(box, there):
    inner = box.here / "inner"
    inner.mkdir()
    (repository(box, inner) / "config").write_text(monitor(box), encoding="utf-8")
    git(box.here, "add", "inner")
    (box.here / ".gitmodules").write_text('[submodule "inner"]\n\tpath = inner\n\turl = ./inner\n', encoding="utf-8")


def _objects(box, there):
    """Objects lie elsewhere, and another program is asked for those that are missing."""
    (there / "objects" / "info" / "alternates").write_text(f"{box.outside}\n", encoding="utf-8")
    promised = '\n[extensions]\n\tpartialClone = evil\n[remote "evil"]\n\turl = "ext::{shell}"\n\tpromisor = true\n'
    _settings(promised + "[protocol]\n\tallow = always\n")(box, there)


def _environment(box):
    """Variables of the reader's shell are his own; those of git are left out."""
    repository(box, box.here)
    config, out = small_experiment.write(box.here), box.here / "computed"
    options = ("-o", out, "-j", 1, "--no-report", "--progress", "none")
    (box.home / ".gitconfig").write_text(monitor(box), encoding="utf-8")
    yield Command(("run", config, *options), (out,), (0,))


REPOSITORIES = {
    "monitor": _monitor,
    "hooks": _hooks,
    "filter": _settings(
        '\n[filter "evil"]\n\tclean = {shell}\n\tsmudge = {shell}\n\tprocess = {shell}\n\trequired = true\n'
    ),
    "include": _settings('\n[include]\n\tpath = "{here}/evil.cfg"\n'),
    "include-if": _settings('\n[includeIf "gitdir:**"]\n\tpath = ../evil.cfg\n'),
    "alias": _settings('\n[alias]\n\tstatus = "!{shell}"\n\trev-parse = "!{shell}"\n'),
    "ssh": _settings('\n[core]\n\tsshCommand = {shell}\n\tgitProxy = {shell}\n[credential]\n\thelper = "!{shell}"\n'),
    "pager": _settings("\n[core]\n\tpager = {shell}\n\teditor = {shell}\n[pager]\n\tstatus = true\n"),
    "diff": _settings('\n[diff]\n\texternal = {shell}\n[diff "evil"]\n\ttextconv = {shell}\n\tcommand = {shell}\n'),
    "worktree": _settings('\n[core]\n\tworktree = "{outside}"\n'),
    "sign": _settings("\n[gpg]\n\tprogram = {shell}\n[log]\n\tshowSignature = true\n"),
    "submodule": _submodule,
    "objects": _objects,
    "file": _moved("real", "gitdir: real\n"),
    "file-absolute": _moved("real", "gitdir: {here}/real\n"),
    "link": _moved("real", None),
    "upper-case": _moved(".GIT", ""),
    "short-name": _moved("git~1", ""),
    "bare": _bare,
    "inside-results": _inside_results,
}


def _code_copy(box):
    """A line is appended to the stored copy of a component: it is not the code of the stored trials."""
    place = box.results("owned")
    (copy,) = (place / "code").rglob("own.py")
    copy.write_text(copy.read_text(encoding="utf-8") + box.python, encoding="utf-8")
    yield from each_of(box, place, "report status compare", name="owned")
    yield from each_of(box, place, "pack show", name="owned", refused=("pack", "show"))


def _code_forbidden(box):
    """Nothing of a directory runs where the user forbids it."""
    place = box.results("owned")
    for command in each_of(box, place, "report status compare pack show sites", name="owned"):
        codes = (2,) if command.words[0] == "show" else command.codes
        yield command._replace(environ=NO_CODE, codes=codes)


def _config_names_code(box):
    """The stored configuration of built-in methods is replaced by one that names a program elsewhere."""
    place = box.results()
    (box.outside / "elsewhere" / "evil.py").write_text(box.python, encoding="utf-8")
    for name in CONFIGS:
        text = small_experiment.text(methods=ESTIMATOR.replace("PATH", "../../outside/elsewhere/evil.py"))
        (place / name).write_text(text, encoding="utf-8")
    yield from each_of(box, place)


def _lying(box):
    """Programs with the names of libraries lie in the results, which are the current directory."""
    place = box.results()
    lay(box, place)
    lay(box, box.here)
    yield from each_of(box, place)


def _pickles(box):
    """Each file is a pickle."""
    for name in (*RECORDS, "traces.npz", "series.csv", "trials.csv", *CONFIGS, *STORE):
        place = box.here / "plain"
        shutil.rmtree(place, ignore_errors=True)
        box.results()
        (place / name).write_bytes(pickled(box))
        yield from (each._replace(note=name) for each in each_of(box, place, "status pack show"))


SECRET = "EIGHT-SECRET-WORDS"


def _foreign_shard(box):
    """Shards of other names, which are links and files."""
    place = box.results("shards")
    folder = place / "shards"
    (folder / "../../../outside").resolve()
    (folder / "3-of-2").mkdir()
    (folder / "1-of-0").mkdir()
    (folder / "\x1b[31m1-of-3").mkdir()
    (folder / "1-of-99999999999999").mkdir()
    shutil.rmtree(folder / "2-of-2")
    (folder / "2-of-2").symlink_to(box.outside / "elsewhere")
    for command in each_of(box, place, "status json merge", name="shards"):
        yield command._replace(codes=(0, 1, 2, 5))


def _large_records(box):
    """Each record has 50 MB, or 200,000 brackets."""
    contents = {
        "deep": b"[" * 200_000,
        "deep-objects": b'{"a":' * 200_000,
        "digits": b'{"seed": ' + b"9" * 1_000_000 + b"}",
        "many": b"[" + b"[]," * 3_000_000 + b"[]]",
        "large": b'{"name": "' + b"x" * 50_000_000 + b'"}',
        "twice": b'{"looks": [1], "looks": 3}',
        "constants": b'{"looks": [NaN, Infinity, -Infinity, 1e999]}',
        "utf16": '{"looks": []}'.encode("utf-16"),
        "surrogate": b'{"name": "\\ud800", "looks": ["\\udfff"]}',
        "nothing": b"",
    }
    for name, content in contents.items():
        place = box.here / "tuned"
        shutil.rmtree(place, ignore_errors=True)
        box.results("tuned")
        for file in RECORDS:
            (place / file).write_bytes(content)
        yield from (each._replace(note=name) for each in each_of(box, place, "status compare pack", name="tuned"))


def _one_large_record(file):
    def cases(box):
        place = box.results("tuned" if file == "tuning.json" else "plain")
        for content in (b"[" * 200_000, b'{"a": [' * 100_000, b"\xff\xfe[]", json.dumps({"a": 1}).encode() * 2):
            (place / file).write_bytes(content)
            yield from each_of(box, place, "status report compare pack sites", name=place.name)

    return cases


OTHERS = {
    "link-whole": _whole_link,
    "link-in-out": _out_has_links,
    "code-copy": _code_copy,
    "code-forbidden": _code_forbidden,
    "code-elsewhere": _config_names_code,
    "code-lying": _lying,
    "pickles": _pickles,
    "shards": _foreign_shard,
    "bomb-records": _large_records,
    **{f"bomb-{file.partition('.')[0]}": _one_large_record(file) for file in RECORDS},
}
CASES = [
    *(
        Case("directory-link", f"{way}-{part}", _file_links(*PARTS[part], make))
        for way, make in WAYS.items()
        for part in PARTS
    ),
    *(Case("directory-link", f"folder-{name}", _folder_links(name, to)) for name, to in FOLDERS.items()),
    *(Case("directory-git", name, in_repository(alter)) for name, alter in REPOSITORIES.items()),
    Case("directory-git", "settings-of-the-reader", _environment),
    *(Case("directory-file", name, make) for name, make in OTHERS.items()),
]
