"""What may execute: files by their bytes, modules of environments, and git, which nothing of a repository reaches."""

import io
import json
import os
import shutil
import subprocess
import sys
import zipfile

import packed
import pytest
from small_experiment import cli

from rmpc_bench.received import consent
from rmpc_bench.received.consent import commit_of, is_code, reason_against_module

RECORDED = """
version: 1
name: r
runs: 1
time: {step: 0.1, steps: 2}
plant: {data: FILE, columns: {y: y}}
model: {kind: linear, A: [[1]], C: [[1]], P_w: 1, P_v: 1}
initial: {x_hat: [0], P: [[1]]}
methods: {A: {estimator: {kind: kalman}}}
metrics: [nis]
"""


def unit(prefix=b"", name="modelDescription.xml"):
    """A zip archive as an FMU is."""
    stream = io.BytesIO(prefix)
    stream.seek(0, io.SEEK_END)
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr(name, "<fmiModelDescription/>")
    return stream.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.fmu", b"", True),
        ("run.csv", unit(), True),
        ("run.npz", unit(b"t,y\n0,1\n"), True),
        ("run.csv", unit(name="MODELDESCRIPTION.XML"), True),
        ("run.csv", b"\x7fELF\x02", True),
        ("run.csv", b"MZ\x90", True),
        ("run.csv", b"\xcf\xfa\xed\xfe", True),
        ("run.csv", b"\xca\xfe\xba\xbe", True),
        ("run.csv", b"#!/bin/sh\n", True),
        ("A.PY", b"", True),
        ("a.pth", b"import os", True),
        ("run.csv", b"t,y\n0,1\n", False),
        ("x.xml", unit(b"<a><!--", name="binaries/linux64/x.so"), True),
        ("x.csv", unit(b"t,y\n0,1\n", name="y.txt"), True),
        ("run.npz", unit(name="y.npy"), False),
        ("run.csv", b"PK\x03\x04", False),
        ("empty.csv", b"", False),
    ],
)
def test_what_can_execute_is_seen_by_its_bytes(tmp_path, name, content, expected):
    (tmp_path / name).write_bytes(content)
    assert is_code(tmp_path / name) == expected


def test_an_fmu_is_code_whatever_it_is_called(tmp_path, monkeypatch):
    """Beside the configuration it is named on stderr; elsewhere it needs consent; NO_CODE refuses it."""
    (tmp_path / "here").mkdir()
    for place in ("here/run.csv", "run.csv"):
        (tmp_path / place).write_bytes(unit())
    inside, outside = tmp_path / "here" / "in.yaml", tmp_path / "here" / "out.yaml"
    inside.write_text(RECORDED.replace("FILE", "run.csv"))
    outside.write_text(RECORDED.replace("FILE", "../run.csv"))
    monkeypatch.chdir(tmp_path)
    found = cli("check", inside)
    assert found.exit_code == 2 and found.stderr.startswith("code  run.csv (sha ")
    refused = cli("check", outside)
    assert refused.exit_code == 2 and not refused.stderr.startswith("code ")
    assert "plant.data: ../run.csv is outside the directory" in refused.stderr
    assert "--allow-code run.csv" in refused.stderr
    assert "code  ../run.csv" in cli("check", outside, "--allow-code", "run.csv").stderr
    monkeypatch.setenv("RMPC_BENCH_NO_CODE", "1")
    refused = cli("check", inside, "--allow-code", ".")
    assert refused.exit_code == 2 and "run.csv: files with code are not loaded, because RMPC" in refused.stderr


def test_an_archive_with_an_fmu_under_another_name_needs_consent(tmp_path, monkeypatch):
    """Nothing of it is read before; without a computation there is nothing to agree to."""
    names = {"config.resolved.yaml": b"]", "data/0/run.csv": unit(b"y\n"), "verified_on.json": b"[]"}
    path = packed.write(tmp_path / "x.zip", {"ro-crate-metadata.json": packed.metadata(names), **names})
    found = cli("verify", path)
    assert found.exit_code == 2 and "has files with code: data/0/run.csv (sha " in found.stderr
    assert "--allow-code" in found.stderr
    assert "has files with code" not in cli("verify", path, "--no-run").stderr
    monkeypatch.setenv("RMPC_BENCH_NO_CODE", "1")
    found = cli("verify", path, "--allow-code", path)
    assert found.exit_code == 2 and "data/0/run.csv: files with code are not loaded" in found.stderr


def test_modules_that_belong_to_no_distribution(tmp_path, monkeypatch):
    """The standard library has modules that act when they are imported; a local file may be anybody's."""
    (tmp_path / "local_module.py").write_text("raise SystemExit('has run')")
    (tmp_path / "numpy_like-1.0.dist-info").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    for module in ("this", "antigravity", "json", "local_module", "no_such", "rmpc_bench.__main__", "numpy.__main__"):
        assert "belongs to no installed distribution" in reason_against_module(f"{module}:Foo-v0"), module
    for text in ("numpy:Foo-v0", "numpy.linalg:Foo-v0", "CartPole-v1", "a b:Foo", "", ":Foo-v0"):
        assert reason_against_module(text) == ""
    monkeypatch.setattr(consent, "accepted", {tmp_path / "local_module.py"})
    assert reason_against_module("local_module:Foo-v0") == ""
    monkeypatch.setenv("RMPC_BENCH_NO_CODE", "1")
    assert "RMPC_BENCH_NO_CODE=1" in reason_against_module("numpy:Foo-v0")


def test_a_module_of_an_editable_distribution(tmp_path, monkeypatch):
    """Its directory is that which the installed metadata name; metadata beside the module name nothing."""
    site, source = tmp_path / "site", tmp_path / "the source"
    for root in (site, source):
        (root / "mine-1.0.dist-info").mkdir(parents=True)
    (source / "editable_module.py").write_text("")
    about = json.dumps({"url": source.as_uri(), "dir_info": {"editable": True}})
    (source / "mine-1.0.dist-info" / "direct_url.json").write_text(about)
    monkeypatch.syspath_prepend(source)
    monkeypatch.setattr(consent.site, "getsitepackages", lambda: [str(site)])
    assert "belongs to no" in reason_against_module("editable_module:Foo-v0")
    (site / "mine-1.0.dist-info" / "direct_url.json").write_text(about)
    assert reason_against_module("editable_module:Foo-v0") == ""


@pytest.mark.parametrize("key", ["env", "options.env_id"])
def test_a_plant_names_no_module_of_somebody_else(tmp_path, monkeypatch, key):
    """Also as an option, which an environment for environments of other libraries imports."""
    pytest.importorskip("gymnasium")
    (tmp_path / "local_env.py").write_text("raise SystemExit('has run')")
    plant = "{env: 'local_env:Foo-v0'}" if key == "env" else "{env: Pendulum-v1, options: {env_id: 'local_env:A-v0'}}"
    path = tmp_path / "e.yaml"
    path.write_text(RECORDED.replace("{data: FILE, columns: {y: y}}", plant))
    monkeypatch.syspath_prepend(tmp_path)
    found = cli("check", path)
    assert found.exit_code == 2 and f"plant.{key}: local_env:" in found.stderr
    assert "has run" not in found.output and "local_env" not in sys.modules


@pytest.fixture
def repository(tmp_path):
    """A repository with one commit, and a command that leaves a mark."""
    top = tmp_path / "top"
    (top / "below").mkdir(parents=True)
    (top / "below" / "a.yaml").write_text("a: 1\n")
    git = ["git", "-C", str(top), "-c", "user.name=a", "-c", "user.email=a@b"]
    for command in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "-m", "first"]):
        subprocess.run([*git, *command], check=True)
    return top


def commit(top):
    return subprocess.run(["git", "-C", str(top), "rev-parse", "HEAD"], capture_output=True, text=True).stdout.strip()


def test_the_commit_and_whether_it_is_all(repository, monkeypatch):
    """From a directory below, with a packed reference, ignored files, and variables that name another repository."""
    expected = commit(repository)
    assert len(expected) == 40
    monkeypatch.setenv("GIT_DIR", "/nowhere")
    assert commit_of(repository / "below") == {"commit": expected, "dirty": False}
    monkeypatch.delenv("GIT_DIR")
    subprocess.run(["git", "-C", str(repository), "pack-refs", "--all"], check=True)
    assert commit_of(repository) == {"commit": expected, "dirty": False}
    (repository / ".git" / "info" / "exclude").write_text("*.log\n")
    (repository / "x.log").write_text("")
    assert commit_of(repository)["dirty"] is False
    (repository / "below" / "a.yaml").write_text("a: 2\n")
    assert commit_of(repository) == {"commit": expected, "dirty": True}
    subprocess.run(["git", "-C", str(repository), "checkout", "--quiet", "--", "."], check=True)
    (repository / "new.yaml").write_text("")
    assert commit_of(repository)["dirty"] is True
    (repository / "verified_on.json").write_text("[]")
    assert commit_of(repository) == {"commit": "unknown"}


SETTINGS = {
    "fsmonitor": "[core]\n fsmonitor = {run}\n",
    "filter": '[filter "x"]\n clean = {run}\n process = {run}\n smudge = {run}\n',
    "diff": '[diff "x"]\n textconv = {run}\n command = {run}\n[diff]\n external = {run}\n',
    "pager": "[core]\n pager = {run}\n[pager]\n status = {run}\n",
    "alias": "[alias]\n status = !{run}\n",
    "hooks": "[core]\n hooksPath = hooks\n",
    "transport": '[core]\n sshCommand = {run}\n[remote "o"]\n url = ext::{run}\n promisor = true\n[extensions]\n'
    " partialClone = o\n",
    "include": "[include]\n path = ../evil.txt\n",
}


@pytest.mark.parametrize("name", SETTINGS)
def test_no_setting_of_a_repository_runs(repository, name):
    """The naive call runs the first of them, which shows that the trap works."""
    mark = repository.parent / "ran"
    script = repository.parent / "run.sh"
    script.write_text(f"#!/bin/sh\ntouch '{mark}'\ncat\n")
    script.chmod(0o755)
    config = repository / ".git" / "config"
    before = config.read_text()
    config.write_text(before + SETTINGS[name].format(run=script))
    (repository / "evil.txt").write_text(SETTINGS["fsmonitor"].format(run=script))
    for hook in ("post-index-change", "fsmonitor-watchman"):
        place = repository / ("hooks" if name == "hooks" else ".git/hooks")
        place.mkdir(exist_ok=True)
        shutil.copy(script, place / hook)
    (repository / ".gitattributes").write_text("* filter=x diff=x\n")
    os.utime(repository / "below" / "a.yaml", (1, 1))
    assert commit_of(repository)["dirty"] is True
    assert not mark.exists()
    if name in ("fsmonitor", "filter", "include"):
        subprocess.run(["git", "-C", str(repository), "status"], capture_output=True)
        assert mark.exists()


def test_a_directory_that_is_no_plain_repository(repository, tmp_path, monkeypatch):
    """A bare repository, a file or a link that leads elsewhere, one in parts, and one of another user start nothing."""
    monkeypatch.setattr(consent.subprocess, "run", None)
    bare = shutil.copytree(repository / ".git", tmp_path / "bare")
    assert commit_of(bare) is None
    for form in ("file", "link", "parts"):
        place = tmp_path / form
        place.mkdir()
        if form == "file":
            (place / ".git").write_text(f"gitdir: {repository / '.git'}\n")
        elif form == "link":
            (place / ".git").symlink_to(repository / ".git")
        else:
            (place / ".git").mkdir()
            (place / ".git" / "HEAD").write_text("ref: refs/../../../top/.git/refs/heads/master\n")
        assert commit_of(place) in (None, {"commit": "unknown"})
    monkeypatch.setattr(consent.os, "getuid", lambda: -1)
    assert commit_of(repository) == {"commit": "unknown"}
    monkeypatch.setenv("RMPC_BENCH_NO_CODE", "1")
    assert commit_of(tmp_path) == {"commit": "unknown"}


def test_a_program_called_git_in_the_current_directory(repository, monkeypatch):
    """An empty entry of the search path is the current directory."""
    mark = repository.parent / "ran"
    (repository / "git").write_text(f"#!/bin/sh\ntouch '{mark}'\n")
    (repository / "git").chmod(0o755)
    monkeypatch.chdir(repository)
    monkeypatch.setenv("PATH", f":.:{os.environ['PATH']}")
    assert commit_of(repository)["dirty"] is True
    assert not mark.exists()


def test_the_command_line_imports_nothing_from_the_current_directory(tmp_path):
    """`python -m` puts it first on the path of Python."""
    (tmp_path / "click.py").write_text("raise SystemExit('has run')")
    command = [sys.executable, "-m", "rmpc_bench", "--help"]
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONSAFEPATH", "PYTHONPATH")}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and "Usage" in done.stdout, done.stderr
