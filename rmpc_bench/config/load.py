"""Loading a configuration: the seven stages from a YAML file to an ExperimentConfig, each called once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rmpc_bench.components.consent import CodeAccess
from rmpc_bench.config.added_methods import texts_of
from rmpc_bench.config.build import build
from rmpc_bench.config.canonical import canonicalise
from rmpc_bench.config.checks import check
from rmpc_bench.config.elsewhere import join_findings
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.inheritance import inherit
from rmpc_bench.config.left_out import Inherited
from rmpc_bench.config.matrix_files import with_matrices
from rmpc_bench.config.origin import problems_at_origin
from rmpc_bench.config.own_code import OwnCode
from rmpc_bench.config.plugins import load_plugins
from rmpc_bench.config.source import read
from rmpc_bench.config.sweep import expand
from rmpc_bench.config.validation import validate_sections
from rmpc_bench.types import ConfigError


def load_config(
    path: str | Path,
    *,
    overrides: Sequence[str] = (),
    runs: int | None = None,
    smoke: bool = False,
    allow_code: Sequence[str | Path] = (),
    add_methods: Sequence[str] = (),
) -> ExperimentConfig:
    """Read, check and build a configuration.

    A stage processes what is valid and collects the errors of the rest, so that all errors are shown at once.

    Parameters
    ----------
    path : the YAML file
    overrides : texts PATH=VALUE, each replacing one value
    runs : number of runs instead of the one in the file
    smoke : whether to take the small size under ``smoke`` instead of the full one
    allow_code : Python files, or directories of such, that may be loaded besides those in the directory of the
        configuration and below
    add_methods : texts ``NAME: {estimator: {..}}``, methods that are added to those of the file

    Raises
    ------
    ConfigError
        If anything is wrong: all errors, sorted, each with its place.
    """
    source = read(path, overrides, add_methods)
    tree = with_matrices(inherit(source), source.path)
    access = CodeAccess.of(source.path, allow_code)
    load_plugins(tree, access)
    sweep = expand(tree, source.overrides, access)
    drafts = validate_sections(sweep.points, runs=runs, smoke=smoke, access=access)
    join_findings(source.path, drafts[0])
    own = OwnCode(access)
    points = build(drafts, own, smoke=smoke)
    # Figures and claims are written for the full size; a reduced or overridden one may be too short for them.
    inherited = Inherited(source.path, is_changed=bool(overrides) or runs is not None)
    claims = check(sweep, drafts, points, inherited, lenient=smoke or bool(overrides))
    built = [point for point in points if point is not None]
    problems = [*sweep.problems, *(problem for draft in drafts for problem in problems_at_origin(draft))]
    problems += own.problems
    if problems or len(built) < len(points):
        raise ConfigError(problems)
    options = source.options(runs, smoke=smoke)
    return canonicalise(
        source.path, sweep, drafts[0], built, claims, own, smoke=smoke, overrides=options, added=texts_of(source.added)
    )
