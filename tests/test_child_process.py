"""Ctrl-C and SIGTERM in a section that delays them, also where another thread gets the signal."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from rmpc_bench.child_process import held

NUMBERS = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture
def noted():
    """Let both signals note their numbers, and return the list of these."""
    found = []
    before = {number: signal.signal(number, lambda number, frame: found.append(number)) for number in NUMBERS}
    yield found
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(params=[False, True], ids=["alone", "with another thread"])
def other_thread(request):
    """Run another thread, which delays no signal: the system may give it one that the main thread delays."""
    ends = threading.Event()
    thread = threading.Thread(target=ends.wait)
    if request.param:
        thread.start()
    yield
    ends.set()
    if request.param:
        thread.join()


@pytest.mark.usefixtures("other_thread")
@pytest.mark.parametrize("depth", [1, 2])
def test_signals_wait_for_the_end_of_the_section(noted, depth):
    """Also for the end of the outer one of two; then each comes once."""
    with held():
        for _ in range(depth - 1):
            with held():
                os.kill(os.getpid(), signal.SIGINT)
        for number in NUMBERS:
            os.kill(os.getpid(), number)
        time.sleep(0.1)
        assert noted == []
    assert sorted(noted) == [*NUMBERS]


@pytest.mark.usefixtures("other_thread")
def test_an_interruption_is_raised_after_the_section():
    """The handler of Python raises it where the section ends, and is there again for the next one."""
    for _ in range(2):
        steps = []
        with pytest.raises(KeyboardInterrupt):
            with held():
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.1)
                steps.append("rest of the section")
            steps.append("after it")
        assert steps == ["rest of the section"]
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, ()) & {*NUMBERS}


def test_a_handler_that_raises_loses_no_other_signal(noted):
    """An interruption leaves the section with an exception; SIGTERM comes all the same."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.raises(KeyboardInterrupt), held():
        for number in NUMBERS:
            os.kill(os.getpid(), number)
    assert noted == [signal.SIGTERM]


def test_an_ignored_signal_stays_ignored():
    """As in the background of a shell; processes that the section starts inherit this."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with held():
            os.kill(os.getpid(), signal.SIGINT)
            program = "import signal; print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)"
            text = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
        assert text.strip() == "True"
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_section_of_another_thread_leaves_the_handlers_alone(noted):
    """Python calls handlers in the main thread, which goes on."""
    found = []

    def section():
        with held():
            os.kill(os.getpid(), signal.SIGINT)
            found.append(signal.pthread_sigmask(signal.SIG_BLOCK, ()) >= {*NUMBERS})

    thread = threading.Thread(target=section)
    thread.start()
    thread.join()
    time.sleep(0.05)
    assert found == [True] and noted == [signal.SIGINT]
