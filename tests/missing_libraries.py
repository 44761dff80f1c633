"""Libraries that are not installed, or are made to look so, in this process or in those that it starts."""

import os
import sys

import pytest

from rmpc_bench.config.plugins import skipped

SITE = "import sys\nsys.modules.update(dict.fromkeys({names!r}))\n"


def skip_without_libraries(path):
    """Skip a test of a configuration by its name if a library that it requires is not installed."""
    if text := skipped(path):
        pytest.skip(text)


def hide(monkeypatch, *modules):
    """Let the import of some modules fail in this process, as if they were not installed."""
    for name in [*sys.modules]:
        if name.partition(".")[0] in modules:
            monkeypatch.delitem(sys.modules, name)
    for name in modules:
        monkeypatch.setitem(sys.modules, name, None)


def hidden_in_children(directory, *modules):
    """Return the environment of processes in which the import of some modules fails.

    Parameters
    ----------
    directory : gets a file that every Python process reads when it starts
    modules : names without dots
    """
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "sitecustomize.py").write_text(SITE.format(names=modules), encoding="utf-8")
    path = os.pathsep.join(filter(None, [str(directory), os.environ.get("PYTHONPATH", "")]))
    return {**os.environ, "PYTHONPATH": path}
