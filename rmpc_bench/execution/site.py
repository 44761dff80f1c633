"""An index of several published experiments: index.html and index.md."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import rmpc_bench
from rmpc_bench.claims.claim import Finding
from rmpc_bench.claims.record import ClaimsRecord
from rmpc_bench.claims.table import claims_record
from rmpc_bench.execution.page_files import PAGE
from rmpc_bench.execution.publish import Publication, experiment_record
from rmpc_bench.regular_file import text_of
from rmpc_bench.replaced_file import replace_text
from rmpc_bench.report.page.headline import headline
from rmpc_bench.report.page.index_page import KINDS, IndexEntry, index_context
from rmpc_bench.report.page.rendering import render_html, render_markdown

CLAIMS = "claims.json"


class KeptClaims(NamedTuple):
    """The findings of an experiment whose trials are not stored, from its kept claims.json."""

    directory: Path
    record: ClaimsRecord


def kept_claims(directory: Path) -> KeptClaims | None:
    """Read the claims.json of a directory; None where there is none, or none that can be read.

    Parameters
    ----------
    directory : of an experiment
    """
    try:
        data: Any = json.loads(text_of(directory / CLAIMS))
        usable = _is_usable(data)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return KeptClaims(directory, data) if usable else None


def _is_usable(data: Any) -> bool:
    """Whether all that an index shows is there; a file of another version may lack some of it."""
    experiment = data["experiment"]
    texts = [experiment["name"], experiment["title"], experiment["command"]]
    for claim in data["claims"]:
        texts += [claim["statement"], claim["source"], claim["id"] or "", Finding(claim["joined"]).value]
        if claim["kind"] not in KINDS:
            return False
    return (
        isinstance(experiment["runs"], int)
        and isinstance(experiment["final"], bool)
        and all(isinstance(text, str) for text in texts)
    )


def write_site(published: Sequence[Publication | KeptClaims], to: Path) -> list[Path]:
    """Write index.html and index.md of several experiments.

    Parameters
    ----------
    published : what `publish` has returned, and kept claims of experiments without trials, in the order of the index
    to : directory to write to

    Returns
    -------
    the files
    """
    to.mkdir(parents=True, exist_ok=True)
    context = index_context([_entry(each, to) for each in published], rmpc_bench.__version__)
    pages = [to / "index.html", to / "index.md"]
    replace_text(pages[0], render_html("page.html", context))
    replace_text(pages[1], render_markdown("page.md", context))
    return pages


def _entry(each: Publication | KeptClaims, to: Path) -> IndexEntry:
    if isinstance(each, KeptClaims):
        record = each.record["experiment"]
        group = record["paper"] or _group(each.directory)
        return IndexEntry(group, record, each.record["claims"], "", "")
    experiment = experiment_record(each.results)
    page = Path(os.path.relpath(each.directory / PAGE, to)).as_posix()
    group = experiment["paper"] or _group(each.results.directory)
    claims = claims_record(each.verdicts, experiment)["claims"]
    return IndexEntry(group, experiment, claims, page, headline(each.tables))


def _group(directory: Path) -> str:
    """Name the group of an experiment without a paper: the directory that it stands in, below ``results``."""
    name = directory.resolve().parent.name
    return "examples" if name == "results" else name
