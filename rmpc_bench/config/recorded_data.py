"""What an experiment with recorded data must be: the plant `data` and the input `file`.

The recorded input is replayed, so that there is no controller.  The data contain their noise and their initial state.
"""

from __future__ import annotations

from collections.abc import Iterator

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.tree import Map
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import InputSignal, Metric, Model, Plant

DATA = "data"
"""Kind of a plant that replays recorded runs."""


def refuse_sections(draft: DraftConfig) -> None:
    """Report the sections that have no meaning beside recorded data."""
    if draft.plant is None or draft.plant.kind != DATA or not draft.plant.is_built_in:
        return
    own = draft.values["methods"] or {}
    places: list[list[str | int]] = [["controller"]] if draft.tree.get("controller") is not None else []
    with_controller = [name for name, each in own.items() if isinstance(each, Map) and "controller" in each]
    places += [["methods", name, "controller"] for name in with_controller]
    for path in places:
        draft.note(path, "the recorded input is replayed, so that no controller can act; leave it out", key=True)
    if "input" in draft.tree:
        draft.note(["input"], "the input is the recorded one, `plant.columns.u`; leave `input` out", key=True)
    if draft.noise.get("process") or draft.noise.get("measurement"):
        draft.note(["noise"], "recorded data contain their noise; leave the section out", key=True)
    if "x" in (draft.values["initial"] or {}):
        draft.note(["initial", "x"], "the true initial state is recorded, or not known; leave `x` out", key=True)


def refuse_runs(draft: DraftConfig, plant: Plant) -> None:
    """Report more runs than there are recorded ones."""
    if plant.recorded is not None:
        _refuse_runs(draft, plant.recorded.n_runs, "plant.data")


def refuse_runs_of_input(draft: DraftConfig, signal: InputSignal) -> None:
    """Report more runs than a recorded input has."""
    if signal.n_runs is not None:
        _refuse_runs(draft, signal.n_runs, "input.file")


def _refuse_runs(draft: DraftConfig, n_files: int, key: str) -> None:
    runs = draft.values["runs"]
    message = f"there are {runs} runs, and `{key}` names {n_files} file{'s' * (n_files != 1)}: file i is run i"
    if runs is not None and runs > n_files and not any(each.message == message for each in draft.problems):
        draft.note(["runs"], message)


def refuse_other_sizes(draft: DraftConfig, name: str, model: Model, plant: Plant) -> bool:
    """Report a design model with other inputs or outputs than the recorded ones; return whether there is an error."""
    # A missing B is one input without effect, which need not be recorded.
    silent = not plant.nu and isinstance(model, Model) and not model.varies and not model.at(0).B.any()
    n_inputs = 0 if silent else model.nu
    wrong = [
        f"{has} {noun} and the recorded data have {recorded}"
        for noun, has, recorded in (("inputs", n_inputs, plant.nu), ("outputs", model.ny, plant.ny))
        if has != recorded
    ]
    if wrong:
        draft.note(["plant"], f"the design model of {name!r} has {', and '.join(wrong)}; see `plant.columns`")
    return bool(wrong)


def metric_problem(component: Component, metric: Metric, plant: Plant) -> str:
    """Say why a metric cannot be computed from recorded data; empty where it can."""
    if plant.recorded is None or plant.nx or metric.of_innovation or not component.is_built_in:
        return ""
    return (
        "needs a state or a closed loop, and the recorded data have no state (`plant.columns.x`); without it there "
        "are nis, innovation_mse and whiteness"
    )


def gap_warnings(draft: DraftConfig, experiment: Experiment) -> Iterator[tuple[list[str | int], str]]:
    """Find estimators that do not bridge the missing measurements of the data."""
    recorded = experiment.plant.recorded
    without = [each.name for each in experiment.methods if not each.estimator.bridges_missing]
    if recorded is not None and recorded.gaps and without:
        names = ", ".join(map(repr, without))
        yield (
            ["plant"],
            f"measurements are missing ({recorded.gaps}), and the estimator of {names} does not bridge them: "
            "these runs diverge there",
        )
