"""Tests of components of optional libraries."""

import pytest

from rmpc_bench import extras


def skip_without_library(group, kind):
    """Skip a test of a kind whose library is not installed."""
    extra = extras.NEEDED_BY.get((group, kind))
    if extra is not None and not extras.is_installed(extra):
        pytest.skip(extras.missing(extra))
