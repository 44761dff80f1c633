"""Messages of a worker process to its parent, which reads what is there and never waits for the rest of one.

`Connection.recv` waits until a message is complete.  A process that is stopped while it sends a large one would stop
its parent too.
"""

from __future__ import annotations

import os
import pickle
import struct
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

_LENGTH = struct.Struct("!Q")
CHUNK = 1 << 20
"""Largest part that is read at once [bytes]."""


def send(connection: Connection, message: Any) -> None:
    """Send a message; wait until the other side has taken all but the end of it."""
    data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    left = memoryview(_LENGTH.pack(len(data)) + data)
    while left:
        left = left[os.write(connection.fileno(), left) :]


class Inbox:
    """What has arrived from a process, and is no complete message yet."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._data = connection, bytearray()

    def messages(self) -> Iterator[Any]:
        """Read once from a connection that is ready, and yield the messages that are complete; EOFError at its end."""
        chunk = os.read(self._connection.fileno(), CHUNK)
        if not chunk:
            raise EOFError
        self._data += chunk
        while (end := self._end()) <= len(self._data):
            data = bytes(self._data[_LENGTH.size : end])
            del self._data[:end]
            yield pickle.loads(data)

    def _end(self) -> int:
        """Return where the first message ends, which is behind what has arrived if its length is not known."""
        known = len(self._data) >= _LENGTH.size
        return _LENGTH.size + (_LENGTH.unpack_from(self._data)[0] if known else len(self._data))
