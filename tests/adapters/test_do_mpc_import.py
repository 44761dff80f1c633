"""do-mpc is imported by a component that uses it, and by nothing else."""

import subprocess
import sys
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "configs" / "examples"
PROGRAM = """
import sys
import rmpc_bench.adapters.do_mpc, rmpc_bench.adapters.explicit_mpc
import do_mpc_tanks
from rmpc_bench.components.single_run import design_function
from inspect import signature
print(*signature(design_function("controllers", do_mpc_tanks.mpc)).parameters)
print({"do_mpc", "casadi", "ppopt"} & {*sys.modules})
"""


def test_reading_the_keys_of_a_component_does_not_import_the_library():
    """The decorators, the file of the example and the keys of its components need no do-mpc."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], cwd=EXAMPLES, capture_output=True, text=True, check=True)
    keys, imported = done.stdout.splitlines()
    assert {"model", "Hp", "R", "preview", "on_failure"} <= {*keys.split()}
    assert imported == "set()"
