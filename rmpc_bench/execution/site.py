"""An index of several published experiments: index.html and index.md."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import rmpc_bench
from rmpc_bench.claims.claim import FINDINGS
from rmpc_bench.claims.record import ClaimsRecord
from rmpc_bench.claims.table import claims_record
from rmpc_bench.execution.page_files import PAGE
from rmpc_bench.execution.publish import Publication, experiment_record
from rmpc_bench.received import plain_files
from rmpc_bench.received.plain_files import json_of
from rmpc_bench.replaced_file import replace_text
from rmpc_bench.report.page.context import answer_of
from rmpc_bench.report.page.rendering import render_html, render_markdown
from rmpc_bench.report.page.statements import KINDS, IndexEntry, index_context

CLAIMS = "claims.json"


class KeptClaims(NamedTuple):
    """The findings of an experiment whose trials are not stored, from its kept claims.json."""

    directory: Path
    record: ClaimsRecord


def kept_claims(directory: Path) -> KeptClaims | None:
    """Read the claims.json of a directory of an experiment; None where there is none, or one of another version."""
    data: Any = json_of(directory / CLAIMS, plain_files.CLAIMS, "`rmpc-bench report` of its trials writes it again")
    words = [(claim["kind"] in KINDS, claim["joined"] in FINDINGS) for claim in data["claims"]] if data else []
    return KeptClaims(directory, data) if data and all(map(all, words)) else None


def write_site(published: Sequence[Publication | KeptClaims], to: Path) -> list[Path]:
    """Write index.html and index.md of several experiments."""
    to.mkdir(parents=True, exist_ok=True)
    context = index_context([_entry(each, to) for each in published], rmpc_bench.__version__)
    pages = [to / "index.html", to / "index.md"]
    replace_text(pages[0], render_html("index.html", context))
    replace_text(pages[1], render_markdown("index.md", context))
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
    verdicts = each.verdicts if each.results.is_final else []
    return IndexEntry(group, experiment, claims, page, answer_of(each.tables, verdicts, each.results.extent))


def _group(directory: Path) -> str:
    """Name the group of an experiment without a paper: the directory that it stands in, below ``results``."""
    name = directory.resolve().parent.name
    return "examples" if name == "results" else name
