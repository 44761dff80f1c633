"""Published configurations at full size, each read and designed once in a process; nobody may change them."""

from functools import lru_cache
from pathlib import Path

from rmpc_bench import load_config

CONFIGS = Path(__file__).parents[1] / "configs"


@lru_cache(maxsize=12)
def loaded(name):
    """Return the configuration with a name such as ``zenere2018/fig7``."""
    return load_config(CONFIGS / f"{name}.yaml")
