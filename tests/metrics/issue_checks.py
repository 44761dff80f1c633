"""What a metric finds before any run, as tests compare it."""

import re


def only_issue(metric, layout, key, message):
    """Assert that the metric finds exactly one issue, at this key and with a message that contains the pattern."""
    found = list(metric.check(layout))
    assert len(found) == 1, found
    assert found[0].key == key
    assert re.search(message, found[0].message), found[0].message


def no_issue(metric, layout):
    """Assert that the metric finds nothing wrong."""
    assert list(metric.check(layout)) == []
