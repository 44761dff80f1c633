"""Loading a configuration: the seven stages from a YAML file to an ExperimentConfig, each called once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rmpc_bench.components.consent import CodeAccess
from rmpc_bench.config.build import build
from rmpc_bench.config.canonical import canonicalise
from rmpc_bench.config.checks import check
from rmpc_bench.config.elsewhere import join_findings
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.left_out import Inherited, fitting_metrics, fitting_sweep
from rmpc_bench.config.origin import problems_at_origin
from rmpc_bench.config.own_code import OwnCode
from rmpc_bench.config.plugins import load_plugins
from rmpc_bench.config.relocation import check_copies
from rmpc_bench.config.required_libraries import reported_once
from rmpc_bench.config.sweep import expand
from rmpc_bench.config.tune_checks import check_tuning
from rmpc_bench.config.tuned_config import with_tuning
from rmpc_bench.config.tuning_plan import Chosen, Origin
from rmpc_bench.config.validation import validate_sections
from rmpc_bench.config_file.inherit import inherit
from rmpc_bench.config_file.known_files import located
from rmpc_bench.config_file.matrix_files import with_matrices
from rmpc_bench.config_file.source import GivenConfig, read, texts_of
from rmpc_bench.config_file.tree import Map
from rmpc_bench.types import ConfigError


def load_config(
    path: str | Path,
    *,
    overrides: Sequence[str] = (),
    runs: int | None = None,
    smoke: bool = False,
    allow_code: Sequence[str | Path] = (),
    add_methods: Sequence[str] = (),
    lenient: bool = False,
) -> ExperimentConfig:
    """Read, check and build a configuration.

    A stage processes what is valid and collects the errors of the rest, so that all errors are shown at once.

    Parameters
    ----------
    path : the YAML file, or the name of an installed configuration such as ``quickstart``
    overrides : texts PATH=VALUE, each replacing one value
    runs : number of runs instead of the one in the file
    smoke : whether to take the small size under ``smoke`` instead of the full one
    allow_code : Python files, or directories of such, that may be loaded besides those in the directory of the
        configuration and below
    add_methods : texts ``NAME: {estimator: {..}}``, methods that are added to those of the file
    lenient : whether figures and claims may reach beyond the end of a run, as they may in a smoke run

    Raises
    ------
    ConfigError
        If anything is wrong: all errors, sorted, each with its place.
    """
    source = read(located(path), overrides, add_methods)
    check_copies(source.path.parent)
    access = CodeAccess.of(source.path, allow_code)
    size = Size(runs, smoke, lenient=lenient or smoke or bool(overrides))
    inherited = Inherited(source.path, is_changed=bool(overrides) or runs is not None)
    tree, left_out = fitting_sweep(with_matrices(inherit(source), source.path), inherited)
    load_plugins(tree, access)
    try:
        return _validated(source, tree, access, size, inherited, left_out, {})
    except ConfigError as error:
        tree, lines = fitting_metrics(tree, error.problems, inherited)
        if not lines:
            raise
    return _validated(source, tree, access, size, inherited, [*left_out, *lines], {})


class Size(NamedTuple):
    """What the options of the command line say about the size of the experiment."""

    runs: int | None
    smoke: bool
    lenient: bool
    """Whether figures and claims may reach beyond the end of a run: they are written for the full size."""


def _validated(
    source: GivenConfig,
    tree: Map,
    access: CodeAccess,
    size: Size,
    inherited: Inherited,
    left_out: Sequence[str],
    chosen: Chosen,
) -> ExperimentConfig:
    """Take a tree through the stages from its sweep on, with the values that tuning has chosen; raises all errors."""
    sweep = expand(tree, source.overrides, access)
    drafts = validate_sections(sweep.points, runs=size.runs, smoke=size.smoke, access=access, chosen=chosen)
    drafts[0].left_out += left_out
    join_findings(source.path, drafts[0])
    own = OwnCode(access)
    points = build(drafts, own, smoke=size.smoke)
    claims = check(sweep, drafts, points, inherited, lenient=size.lenient)
    check_tuning(drafts, points, inherited)
    built = [point for point in points if point is not None]
    problems = [*sweep.problems, *(problem for draft in drafts for problem in problems_at_origin(draft))]
    problems += own.problems
    if problems or len(built) < len(points):
        raise ConfigError(reported_once(problems))
    options, added = source.options(size.runs, smoke=size.smoke), texts_of(source.added)
    config = canonicalise(
        source.path, sweep, drafts[0], built, claims, own, smoke=size.smoke, overrides=options, added=added
    )
    again = partial(_validated, source, tree, access, size, inherited, left_out)
    return with_tuning(config, drafts, Origin(sweep.points, access, size.smoke, again))
