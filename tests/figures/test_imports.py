"""What the modules of figures import; `check` and `schema` load them all and have to stay fast."""

import subprocess
import sys

from rmpc_bench.registry import names

HEAVY = {"pandas", "matplotlib", "scipy", "numba", "jinja2"}


def test_figures_are_loaded_without_the_libraries_that_draw_them():
    program = (
        "import sys\nfrom rmpc_bench.registry import get, names\n"
        "print(*(get('figures', name).__name__ for name in names('figures')))\n"
        "print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    kinds, modules = done.stdout.splitlines()
    assert len(kinds.split()) == len(list(names("figures")))
    assert not HEAVY & set(modules.split())
