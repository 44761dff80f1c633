"""Copies of a user's files in a directory of results: an altered one is an error before any use."""

import shutil

import pytest
from own_experiment import write_own
from small_experiment import cli


def run(path, out, *options):
    """Run without workers."""
    return cli("run", path, "-o", out, "-j", 1, "--progress", "none", *options)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the directory of an experiment with own components."""
    place = tmp_path_factory.mktemp("made")
    assert run(write_own(place), place / "out").exit_code == 0
    return place


@pytest.mark.parametrize("alteration", ["append", "add", "link", "swap"])
@pytest.mark.parametrize("command", ["report", "pack", "show", "run", "check", "compare"])
def test_an_altered_copy(made, tmp_path, command, alteration):
    """Exit code 2, the folder and the way out, and the code does not run."""
    shutil.copytree(made, tmp_path / "all")
    out, ran = tmp_path / "all" / "out", tmp_path / "ran"
    first, *_ = sorted((out / "code").rglob("*.py"))
    folder = out / "code" / first.relative_to(out / "code").parts[0]
    if alteration == "append":
        first.write_text(first.read_text() + f"\nopen({str(ran)!r}, 'w')\n")
    elif alteration == "add":
        (folder / "numpy.py").write_text(f"open({str(ran)!r}, 'w')\n")
    elif alteration == "link":
        shutil.copy(first, tmp_path / "elsewhere.py")
        first.unlink()
        first.symlink_to(tmp_path / "elsewhere.py")
    else:
        folder.rename(folder.with_name("0" * 16))
    arguments = {
        "report": [out],
        "pack": [out, "-o", tmp_path / "p.zip"],
        "show": [out, "--run", 0, "--method", "good"],
        "run": [tmp_path / "all" / "own.yaml", "-o", out, "--runs", 9],
        "check": [out / "config.resolved.yaml"],
        "compare": [out, made / "out"],
    }[command]
    result = cli(command, *arguments)
    assert result.exit_code == 2, result.output
    assert "code/" in result.stderr and "Traceback" not in result.stderr
    assert not ran.exists() and not (tmp_path / "p.zip").exists()


def test_an_honest_directory(made, tmp_path):
    """An edit of the user's file, with a comment or with other numbers, leaves the earlier copies as they are."""
    shutil.copytree(made, tmp_path / "all")
    path, out = tmp_path / "all" / "own.yaml", tmp_path / "all" / "out"
    mine = tmp_path / "all" / "mine.py"
    mine.write_text("# a comment\n" + mine.read_text())
    assert run(path, out).exit_code == 0
    mine.write_text(mine.read_text() + "\n\ndef unused():\n    return 2\n")
    assert run(path, out).exit_code == 0
    assert cli("report", out).exit_code == 0
