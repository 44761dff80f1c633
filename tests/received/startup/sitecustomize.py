"""Installs the audit hook of the battery in a process before it imports anything else; see `audit.py`.

The directory of this file is on PYTHONPATH of the processes of the battery, and nowhere else.
"""

import os
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

NAME = "rmpc_bench_test_audit"

if os.environ.get("RMPC_BENCH_TEST_AUDIT") and NAME not in sys.modules:
    _spec = spec_from_file_location(NAME, Path(__file__).parents[1] / "audit.py")
    sys.modules[NAME] = _module = module_from_spec(_spec)
    _spec.loader.exec_module(_module)
    _module.install(os.environ["RMPC_BENCH_TEST_AUDIT"])
