"""rmpc-bench: Monte Carlo comparison of estimator-controller pairs under model mismatch and unmodelled noise.

The names below are loaded at their first use, so that the import of the package is fast.
"""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"

NUMERICS = 3
"""Version of the arithmetic, a part of the identity of trials: every change that alters numbers raises it.

Trials of another version are kept apart and computed again; tests/test_numerics.py guards it."""

_PUBLIC: dict[str, str] = {
    "LinearModel": "rmpc_bench.models.linear",
    "Scenario": "rmpc_bench.simulation.scenario",
    "Experiment": "rmpc_bench.simulation.scenario",
    "Method": "rmpc_bench.types",
    "Status": "rmpc_bench.types",
    "Trials": "rmpc_bench.analysis.trials",
    "simulate": "rmpc_bench.simulation.closed_loop",
    "load_config": "rmpc_bench.config.load",
    "run": "rmpc_bench.execution.run",
    "merge": "rmpc_bench.execution.merge",
    "load_results": "rmpc_bench.results.results",
    "load_trials": "rmpc_bench.results.results",
    "Results": "rmpc_bench.results.results",
    "replay": "rmpc_bench.execution.replay",
    "summarise": "rmpc_bench.results.evaluate",
    "compare": "rmpc_bench.results.evaluate",
    "drivers": "rmpc_bench.results.evaluate",
    "requirements": "rmpc_bench.results.evaluate",
    "ranks": "rmpc_bench.results.evaluate",
    "tuning": "rmpc_bench.publishing.publish",
    "compare_results": "rmpc_bench.results.compare",
    "compare_improvements": "rmpc_bench.results.compare",
    "judge": "rmpc_bench.results.evaluate",
    "figure": "rmpc_bench.results.evaluate",
    "publish": "rmpc_bench.publishing.publish",
    "pack": "rmpc_bench.packing.pack",
    "verify": "rmpc_bench.packing.verify",
    "single_run": "rmpc_bench.components.single_run",
    "SolverError": "rmpc_bench.types",
    "Estimator": "rmpc_bench.types",
    "Controller": "rmpc_bench.types",
    "Plant": "rmpc_bench.types",
    "Metric": "rmpc_bench.types",
    "Figure": "rmpc_bench.types",
    "register": "rmpc_bench.registry",
    "plant": "rmpc_bench.components.designs",
    "model": "rmpc_bench.components.designs",
    "estimator": "rmpc_bench.components.designs",
    "controller": "rmpc_bench.components.designs",
}


def __getattr__(name: str) -> Any:
    """Import a public name at its first use."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted([*_PUBLIC, "NUMERICS", "__version__"])
