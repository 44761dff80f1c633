"""The limit of time of a request on a machine that is busy with other programs."""

import subprocess
import sys
import time

import pytest

from rmpc_bench.components.probe_process import waits_for_a_processor

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="other systems show no states of processes as files")


@pytest.fixture
def running():
    """Start Python programs, and end them after the test."""
    started = []

    def start(text):
        started.append(subprocess.Popen([sys.executable, "-c", f"print(flush=True)\n{text}"], stdout=subprocess.PIPE))
        started[-1].stdout.readline()
        return started[-1].pid

    yield start
    for each in started:
        each.kill()
        each.communicate()


def test_a_computation_below_its_limit_goes_on(running):
    """It has had less time of a processor than the limit."""
    assert waits_for_a_processor(running("while True: pass"), 1000.0)


def test_a_computation_beyond_its_limit_ends(running):
    """An endless loop has used up its time."""
    child = running("while True: pass")
    time.sleep(0.5)
    assert not waits_for_a_processor(child, 0.01)


def test_a_process_that_waits_for_something_else_ends(running):
    """For the network or for a lock, for instance: more time would not help."""
    child = running("import time; time.sleep(1000)")
    time.sleep(0.5)
    assert not waits_for_a_processor(child, 1000.0)


def test_a_process_that_has_ended_does_not_wait():
    """Its number is free."""
    done = subprocess.Popen([sys.executable, "-c", ""])
    done.wait()
    assert not waits_for_a_processor(done.pid, 1000.0)
