"""Messages that arrive in parts are read as they come, without waiting."""

import os
import threading
from multiprocessing import Pipe

import numpy as np
import pytest

from rmpc_bench.engines.messages import Inbox, send


@pytest.fixture
def ends():
    """Both ends of a connection."""
    here, there = Pipe()
    yield here, there
    here.close()
    there.close()


def test_what_is_sent_arrives(ends):
    """One after the other, also several of them in one part; the end of the other side is an error."""
    here, there = ends
    inbox, sent = Inbox(here), [None, "text", {"a": [1, 2]}]
    for message in sent:
        send(there, message)
    assert [*inbox.messages()] == sent
    there.close()
    with pytest.raises(EOFError):
        [*inbox.messages()]


def test_a_part_of_a_message_is_kept(ends):
    """Byte by byte: nothing is waited for, and the message is there with its last byte."""
    here, there = ends
    other, copy = Pipe()
    send(copy, ["x", 3])
    data = os.read(other.fileno(), 1000)
    inbox, found = Inbox(here), []
    for place in range(len(data)):
        assert found == []
        os.write(there.fileno(), data[place : place + 1])
        found += inbox.messages()
    assert found == [["x", 3]]
    other.close()
    copy.close()


def test_a_message_that_is_larger_than_what_is_read_at_once(ends):
    """It comes in many parts while the other side sends."""
    here, there = ends
    values = np.arange(700_000)
    thread = threading.Thread(target=send, args=(there, values))
    thread.start()
    inbox, found, n_parts = Inbox(here), [], 0
    while not found:
        found += inbox.messages()
        n_parts += 1
    thread.join()
    np.testing.assert_array_equal(found[0], values)
    assert n_parts > 5
