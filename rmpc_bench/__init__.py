"""rmpc-bench: Monte Carlo comparison of estimator-controller pairs under model mismatch and unmodelled noise.

The names below are loaded at their first use, so that the import of the package is fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials as Trials
    from rmpc_bench.components.designs import register as register
    from rmpc_bench.components.single_run import single_run as single_run
    from rmpc_bench.config.load import load_config as load_config
    from rmpc_bench.config_file.factories import controller as controller
    from rmpc_bench.config_file.factories import estimator as estimator
    from rmpc_bench.config_file.factories import model as model
    from rmpc_bench.config_file.factories import plant as plant
    from rmpc_bench.execution.filter_data import filter_data as filter_data
    from rmpc_bench.execution.merge import merge as merge
    from rmpc_bench.execution.replay import replay as replay
    from rmpc_bench.execution.replay import run_one as run_one
    from rmpc_bench.execution.run import run as run
    from rmpc_bench.importing.directory import import_runs as import_runs
    from rmpc_bench.models.linear import LinearModel as LinearModel
    from rmpc_bench.packing.pack import pack as pack
    from rmpc_bench.packing.verify import verify as verify
    from rmpc_bench.publishing.figure_files import figure as figure
    from rmpc_bench.publishing.publish import publish as publish
    from rmpc_bench.publishing.publish import tuning as tuning
    from rmpc_bench.results.compare import compare_improvements as compare_improvements
    from rmpc_bench.results.compare import compare_results as compare_results
    from rmpc_bench.results.evaluate import compare as compare
    from rmpc_bench.results.evaluate import drivers as drivers
    from rmpc_bench.results.evaluate import judge as judge
    from rmpc_bench.results.evaluate import ranks as ranks
    from rmpc_bench.results.evaluate import requirements as requirements
    from rmpc_bench.results.evaluate import summarise as summarise
    from rmpc_bench.results.results import Results as Results
    from rmpc_bench.results.results import load_results as load_results
    from rmpc_bench.results.results import load_trials as load_trials
    from rmpc_bench.simulation.closed_loop import simulate as simulate
    from rmpc_bench.simulation.scenario import Experiment as Experiment
    from rmpc_bench.simulation.scenario import Scenario as Scenario
    from rmpc_bench.types import Controller as Controller
    from rmpc_bench.types import Estimator as Estimator
    from rmpc_bench.types import Figure as Figure
    from rmpc_bench.types import Method as Method
    from rmpc_bench.types import Metric as Metric
    from rmpc_bench.types import Plant as Plant
    from rmpc_bench.types import SolverError as SolverError
    from rmpc_bench.types import Status as Status

__version__ = "0.1.0"

NUMERICS = 4
"""Version of the arithmetic, a part of the identity of trials: every change that alters numbers raises it.

Trials of another version are kept apart and computed again; tests/test_numerics.py guards it."""

_MODULES = {
    "rmpc_bench.analysis.trials": "Trials",
    "rmpc_bench.components.designs": "register",
    "rmpc_bench.components.single_run": "single_run",
    "rmpc_bench.config.load": "load_config",
    "rmpc_bench.config_file.factories": "controller estimator model plant",
    "rmpc_bench.execution.filter_data": "filter_data",
    "rmpc_bench.execution.merge": "merge",
    "rmpc_bench.execution.replay": "replay run_one",
    "rmpc_bench.execution.run": "run",
    "rmpc_bench.importing.directory": "import_runs",
    "rmpc_bench.models.linear": "LinearModel",
    "rmpc_bench.packing.pack": "pack",
    "rmpc_bench.packing.verify": "verify",
    "rmpc_bench.publishing.figure_files": "figure",
    "rmpc_bench.publishing.publish": "publish tuning",
    "rmpc_bench.results.compare": "compare_improvements compare_results",
    "rmpc_bench.results.evaluate": "compare drivers judge ranks requirements summarise",
    "rmpc_bench.results.results": "Results load_results load_trials",
    "rmpc_bench.simulation.closed_loop": "simulate",
    "rmpc_bench.simulation.scenario": "Experiment Scenario",
    "rmpc_bench.types": "Controller Estimator Figure Method Metric Plant SolverError Status",
}
_PUBLIC = {name: module for module, names in _MODULES.items() for name in names.split()}
"""Public name -> the module that has it; type checkers read the imports above."""

__all__ = ["NUMERICS", *_PUBLIC]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted([*__all__, "__version__"])
