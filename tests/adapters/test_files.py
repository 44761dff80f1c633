"""The table of the package: a file is found by the name of its library."""

import re
from importlib import import_module
from pathlib import Path

from rmpc_bench import adapters, registry

ROWS = [line for line in adapters.__doc__.splitlines() if "`" in line]
FILES = [re.split(r"\s{2,}", line)[1] for line in ROWS]


def test_every_file_begins_with_its_library():
    """Each file is the one of a row, or continues its name."""
    stems = {path.stem for path in Path(adapters.__path__[0]).glob("*.py")} - {"__init__"}
    assert set(FILES) <= stems
    assert [each for each in stems if not any(f"{each}_".startswith(f"{file}_") for file in FILES)] == []


def test_names_of_the_table_are_there():
    """A name is a function of the file of its row, or a kind whose design is in a file of the library."""
    kinds = {
        kind: target for group in registry.BUILT_IN.values() for kind, target in group.items() if "adapters" in target
    }
    written = set()
    for file, row in zip(FILES, ROWS, strict=True):
        names = re.findall(r"`(.+?)`", row)
        written |= set(names)
        for name in names:
            if name in kinds:
                assert kinds[name].startswith(f"rmpc_bench.adapters.{file}")
            else:
                assert callable(getattr(import_module(f"rmpc_bench.adapters.{file}"), name))
    assert set(kinds) <= written
