"""Error of worker processes, in a module that the command line imports without any engine."""


class WorkerError(Exception):
    """Worker processes cannot load the experiment."""
