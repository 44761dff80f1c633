"""`run` where no trial is missing: nothing is imported, computed or written unless something has changed."""

import os
import re
import subprocess
import sys
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest
from small_experiment import cli, write

from rmpc_bench.cli.run_request import Request
from rmpc_bench.config_file.known_files import file_beside
from rmpc_bench.publishing import published
from rmpc_bench.publishing.published import FILE, Command
from rmpc_bench.received.plain_files import noted

CODE = """
import sys
from rmpc_bench.cli import main
try:
    main(sys.argv[1:], prog_name="rmpc-bench")
except SystemExit as done:
    assert not done.code, done.code
print(*{name.split(".")[0] for name in sys.modules}, *sys.modules, file=sys.stderr)
"""


@pytest.fixture
def finished(tmp_path, monkeypatch):
    """Call `run` in a directory whose results are published; return what was written meanwhile."""
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path, runs=3)
    first = cli("run", path, "-o", "out", "-j", "1")
    assert first.exit_code == 0, first.stderr

    def again(*options):
        before = times(tmp_path / "out")
        done = cli("run", path, "-o", "out", "-j", "1", *options)
        after = times(tmp_path / "out")
        return done, {name for name in {*before, *after} if before.get(name) != after.get(name)}

    again.path, again.out, again.first = path, tmp_path / "out", first
    return again


def times(directory):
    return {
        path.relative_to(directory).as_posix(): path.lstat().st_mtime_ns
        for path in directory.rglob("*")
        if path.is_file()
    }


def untimed(text):
    return re.sub(r"(0 failed), [\d.]+ s\n", r"\1\n", text)


def test_nothing_is_written(finished):
    """The screen is the same but for the time."""
    done, written = finished()
    assert (done.exit_code, written) == (0, set())
    assert untimed(done.stdout) == untimed(finished.first.stdout)
    assert untimed(done.stdout) != done.stdout


def test_nothing_heavy_is_imported(finished):
    command = [sys.executable, "-c", CODE, "run", finished.path, "-o", "out", "-j", "1"]
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    modules = {*done.stderr.split()}
    heavy = {"numpy", "scipy", "pydantic", "yaml", "numba", "pandas", "matplotlib", "joblib", "jinja2", "rich"}
    assert not modules & heavy


def _must_not_load(*arguments, **options):
    raise AssertionError("the configuration is loaded")


@pytest.fixture
def inheriting(finished, monkeypatch):
    """Call `run` of a configuration that extends another one; `loads` of it says whether it was loaded again."""
    child = finished.path.with_name("child.yaml")
    child.write_text(f"extends: {finished.path.name}\nname: child\n", encoding="utf-8")

    def run(*options):
        done = cli("run", child, "-j", "1", *options)
        assert done.exit_code == 0, done.stderr
        return done

    def loads(*options):
        with monkeypatch.context() as patched:
            patched.setattr(Request, "load", _must_not_load)
            return cli("run", child, "-j", "1", *options).exit_code != 0

    run()
    run.loads, run.base, run.child = loads, finished.path, child
    return run


def test_the_configuration_is_not_loaded_without_output_option(inheriting):
    """The directory is found although its name stands in a file that is not read as YAML."""
    assert not inheriting.loads()
    os.utime(inheriting.base)
    assert not inheriting.loads() and not inheriting.loads("-v") and not inheriting.loads("--strict")


@pytest.mark.parametrize("options", [["--runs", "2"], ["-s", "runs=3"], ["--only", "S-MPC"], ["--smoke"], ["--fresh"]])
def test_other_options_load_the_configuration(inheriting, options):
    assert inheriting.loads(*options)
    assert not inheriting.loads()


def test_every_file_of_the_configuration_counts(inheriting):
    """The extended file, one that is deleted, and a file beside whose claims may be others of the same paper."""
    text = inheriting.base.read_text("utf-8")
    inheriting.base.write_text(text + "title: Another title\n", encoding="utf-8")
    assert inheriting.loads()
    assert "Another title" in (inheriting() and Path("results/child/report.html").read_text("utf-8"))
    assert not inheriting.loads()
    beside = inheriting.child.with_name("beside.yaml")
    beside.write_text("name: beside\n", encoding="utf-8")
    assert inheriting.loads()
    beside.unlink()
    assert not inheriting.loads()
    inheriting.base.unlink()
    assert inheriting.loads() and cli("run", inheriting.child).exit_code == 2


def test_a_file_that_is_looked_for_first(tmp_path, monkeypatch):
    """The name of an installed configuration means a file of the same name once there is one."""
    monkeypatch.chdir(tmp_path)
    with noted() as read:
        assert file_beside(tmp_path, "quickstart").is_file()
    assert read == {str(tmp_path / "quickstart"): ""}
    command = Command.of([], tmp_path / "a.yaml", read | {str(tmp_path / "a.yaml"): sha256(b"").hexdigest()})
    (tmp_path / "a.yaml").write_bytes(b"")
    command = replace(command, beside=["a.yaml"])
    assert command.is_that_of([], tmp_path / "a.yaml")
    (tmp_path / "quickstart").write_text("name: mine\n")
    assert not command.is_that_of([], tmp_path / "a.yaml")


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("summary.csv", "deleted"),
        ("manifest.json", "deleted"),
        ("report.html", "edited"),
        ("config.yaml", "edited"),
        ("tables/summary.md", "replaced by a link"),
    ],
)
def test_a_file_that_has_changed_is_written_again(finished, name, how):
    file = finished.out / name
    content = file.read_bytes()
    file.unlink()
    if how == "edited":
        file.write_bytes(content + b" ")
    elif how == "replaced by a link":
        file.symlink_to(finished.out.parent / "elsewhere")
    done, written = finished()
    assert done.exit_code == 0 and name in written
    assert file.is_file() and not file.is_symlink()
    if name not in ("manifest.json", "report.html"):
        assert file.read_bytes() == content
    assert finished()[1] == set()


def test_more_runs_or_another_text_in_the_configuration(finished):
    done, written = finished("--runs", "4")
    assert "4 of 4 runs" in done.stdout and {"trials.csv", "trials.sqlite"} <= written
    text = finished.path.read_text("utf-8")
    finished.path.write_text(text + "title: Another title\n", encoding="utf-8")
    assert "report.html" in finished("--runs", "4")[1]
    assert finished("--runs", "4")[1] == set()


def test_another_option(finished):
    """Such as one that changes what is shown; those that change only how it is computed do not count."""
    assert "report.html" in finished("--only", "S-MPC")[1]
    assert finished()[1] != set()
    assert finished("--progress", "none")[1] == set()


def test_a_store_that_has_changed(finished):
    """The time of the file stands for a store that was copied into the directory."""
    os.utime(finished.out / "trials.sqlite")
    assert "summary.csv" in finished()[1]


def test_another_version_of_a_library_or_of_the_code(finished, monkeypatch):
    monkeypatch.setattr(published, "version_of", lambda name: "0.0")
    assert "report.html" in finished()[1]
    monkeypatch.setattr(published, "_sources", lambda: [])
    assert "report.html" in finished()[1]
    assert finished()[1] == set()


@pytest.mark.parametrize("text", ["", "[]", "\udcff"])
def test_a_damaged_note_is_no_note(finished, text):
    (finished.out / FILE).write_bytes(text.encode("utf-8", "surrogateescape"))
    done, written = finished()
    assert done.exit_code == 0 and {FILE, "report.html"} <= written


def test_exit_codes_are_kept(tmp_path, monkeypatch):
    """A claim that differs from its record, and a run without --strict."""
    monkeypatch.chdir(tmp_path)
    claims = "[{says: wrong, check: 'mean(mse[S-MPC]) > 1e9', finding: confirmed}]"
    path = write(tmp_path, runs=3, claims=claims)
    first = cli("run", path, "-o", "out", "-j", "1")
    assert first.exit_code == 0, first.stderr
    assert cli("run", path, "-o", "out").exit_code == 0
    assert cli("run", path, "-o", "out", "--strict").exit_code == 1
    assert cli("run", path, "-o", "out", "--strict", "--fresh", "-j", "1").exit_code == 1
