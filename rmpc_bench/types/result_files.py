"""Names of the files of a directory of results that several rooms read."""

from __future__ import annotations

CONFIG = "config.yaml"
"""Copy of the configuration."""
RESOLVED = "config.resolved.yaml"
"""The configuration with every key."""
COPIES = "code"
"""Directory of the copies of Python files."""
SHARDS = "shards"
"""Directory of the results of every shard."""
