"""A worker that the system does not start: what is said, and that nothing of it stays open."""

import errno
import os

import pytest

from rmpc_bench.engines import workers
from rmpc_bench.engines.pool import Pool
from rmpc_bench.engines.watch import Limits
from rmpc_bench.types.errors import WorkerError


@pytest.mark.parametrize("number", [errno.EMFILE, errno.EAGAIN])
def test_a_worker_that_does_not_start(monkeypatch, number):
    """Oracle: the sentence, which is no report on results, and as many open files as before."""

    def refused(*arguments, **keys):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(workers, "start", refused)
    pool, before = Pool(b"", Limits(), None), os.listdir("/dev/fd")
    with pytest.raises(WorkerError) as error:
        pool.start([12])
    assert str(error.value) == f"cannot start worker 13: {os.strerror(number)}; give fewer workers (--jobs)"
    # The error holds the frames in which the files were opened: nothing is closed by chance.
    assert len(os.listdir("/dev/fd")) == len(before)
