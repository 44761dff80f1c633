"""Standard streams that are closed, that nobody reads or that are full."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from small_experiment import write

PROGRAM = f"{sys.executable} -m rmpc_bench"


def shell(command, directory, **environment):
    """Run a command line of bash with pipefail; return its exit code, output and messages."""
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command}"],
        cwd=directory,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done


@pytest.mark.parametrize("streams", [">&- 2>&- <&-", "2> >(true) | true", "2>/dev/full"])
@pytest.mark.long
def test_run_without_a_reader(tmp_path, streams):
    """The results are complete, and exit code 0."""
    path = write(tmp_path, runs=2)
    done = shell(f"{PROGRAM} run {path} -o out -j 1 {streams}", tmp_path)
    assert done.returncode == 0, done.stderr
    assert {"trials.sqlite", "trials.csv", "summary.csv", "report.html"} <= {
        p.name for p in (tmp_path / "out").iterdir()
    }


def test_no_file_takes_the_number_of_a_closed_stream(tmp_path):
    """Else messages would be written into the next file that is opened."""
    code = "import os; from rmpc_bench.cli.streams import usable_streams; usable_streams(); "
    code += "opened = open('file', 'w').fileno(); print('text', file=__import__('sys').stderr); "
    code += "open('numbers', 'w').write(str(opened))"
    done = shell(f'{sys.executable} -c "{code}" >&- 2>&- <&-', tmp_path)
    assert done.returncode == 0
    assert int((tmp_path / "numbers").read_text()) > 2
    assert (tmp_path / "file").read_text() == ""


@pytest.mark.parametrize("streams", ["2>&-", "2> >(true)"])
def test_an_error_keeps_its_exit_code(tmp_path, streams):
    assert shell(f"{PROGRAM} run nothing.yaml {streams}", tmp_path).returncode == 2


@pytest.mark.parametrize("arguments", ["--help", "list configs"])
def test_a_full_disk_is_an_error(tmp_path, arguments):
    """Where the output is asked for and cannot be written: exit code 74 and one line."""
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    done = shell(f"{PROGRAM} {arguments} > /dev/full", tmp_path)
    assert done.returncode == 74
    assert "cannot be written" in done.stderr.splitlines()[-1]


@pytest.mark.long
def test_results_are_not_lost_with_the_output(tmp_path):
    """The message says which of the two could not be written."""
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    path = write(tmp_path)
    done = shell(f"{PROGRAM} run {path} -o out -j 1 > /dev/full", tmp_path)
    assert done.returncode == 74 and (tmp_path / "out" / "summary.csv").exists()
    assert done.stderr.splitlines()[-1].startswith("the output cannot be written: ")
    assert "results in files are not affected" in done.stderr


def test_list_and_head(tmp_path):
    done = shell(f"{PROGRAM} list configs | head -1", tmp_path)
    assert (done.returncode, len(done.stdout.splitlines()), done.stderr) == (0, 1, "")
