"""The metadata of an archive: an RO-Crate 1.1 with the profile Process Run Crate 0.5, and a citation file."""

from __future__ import annotations

import mimetypes
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any, NamedTuple

import rmpc_bench
from rmpc_bench.claims.claim import IDENTIFIERS
from rmpc_bench.received.consent import VERIFIED
from rmpc_bench.results.record import StoredExperiment

CITATION = "CITATION.cff"
PROFILE = "https://w3id.org/ro/wfrun/process/0.5"
LICENCES = "https://spdx.org/licenses/"
NO_LICENCE = "No licence is stated; ask the authors before you use these results"
UNKNOWN_AUTHORS = "The authors of the experiment"
DESCRIPTIONS: Mapping[str, str] = {
    "config.yaml": "The configuration as given",
    "source.csv.gz": "The table of runs, which another program has made",
    "source.parquet": "The table of runs, which another program has made",
    "config.resolved.yaml": "The configuration with every default filled in; it loads from this archive",
    "manifest.json": "Experiment hash, seed, versions of libraries, platform, times of the sessions",
    "trials.csv": "One row per method and run: status and metrics",
    "uncertainty.csv": "One row per run: values of the uncertain quantities",
    "series.csv": "What is indexed by time: gains, reported covariances, moments",
    "traces.npz": "Trajectories of the recorded runs",
    "timings.csv": "Times of computation of own components",
    "summary.csv": "Metrics of every method: mean, standard error, interval, median, quartiles, failed runs",
    "comparisons.csv": "Every method against the baseline, paired by run",
    "drivers.csv": "Share of the variance of the comparison that each uncertain quantity explains",
    "requirements.csv": "Runs that meet a requirement",
    "lost.csv": "Share of the runs that are lost, with its interval",
    "ranks.csv": "Rank of every method over all points of the sweep, as an interval, and ratios to the baseline",
    "calibration.csv": "Whether the reported covariances agree with the errors",
    "two-way.csv": "Main effects and interactions of two axes of methods",
    "tuning.csv": "Tuned parameters: range, default, tuned and best value, objectives, regret, rank",
    "tuning.json": "Every value that tuning has tried, with the metric of its runs",
    "tuning/seconds.json": "Computing times of the searches of tuning",
    "claims.json": "Statements with findings, numbers and assumptions, for programs",
    "claims.md": "Statements with findings, numbers and assumptions, for readers",
    "report.html": "The report: comparison, claims, figures, assumptions, limitations",
    "report.md": "The report in Markdown",
    CITATION: "How to cite these results",
    VERIFIED: "Verifications on other machines: date, versions, result",
}
FOLDERS: Mapping[str, str] = {
    "tables": "Table of the comparison",
    "figures": "Figure",
    "failures": "A failed run, with the command that computes it again",
    "code": "Python file of the user, as it was when the runs were computed",
    "data": "Data file of the user",
}  # directory -> description of its files
_TYPES = {
    **{".yaml": "application/yaml", ".cff": "application/yaml", ".md": "text/markdown", ".py": "text/x-python"},
    **{".npz": "application/zip", ".csv": "text/csv", ".tex": "application/x-tex", ".html": "text/html"},
    **{".svg": "image/svg+xml", ".pdf": "application/pdf", ".png": "image/png", ".json": "application/json"},
    ".txt": "text/plain",
}
_INPUTS = ("config.resolved.yaml", "source.csv.gz", "source.parquet")
_NO_RESULTS = ("config.yaml", *_INPUTS, CITATION)  # files at the top that no computation has made


class Contents(NamedTuple):
    """What an archive is about; `hashes` has the SHA-256 and the size [bytes] of every file."""

    experiment: StoredExperiment
    manifest: Mapping[str, Any]
    n_runs: int
    incomplete: tuple[str, ...]
    hashes: Mapping[str, tuple[str, int]]
    authors: tuple[str, ...]
    licence: str

    @property
    def title(self) -> str:
        """Title of the experiment, or its name."""
        return self.experiment.title or self.experiment.name

    @property
    def sessions(self) -> list[dict[str, Any]]:
        """Sessions of the computation."""
        return [each for each in self.manifest.get("sessions", []) if isinstance(each, dict) and each.get("start")]

    @property
    def finished(self) -> str:
        """Time of the end of the last session in ISO 8601; the archive has this date, so that its bytes repeat."""
        times = [each.get("stop") or each["start"] for each in self.sessions]
        return max(times, default="1980-01-01T00:00:00+00:00")

    @property
    def paper(self) -> tuple[str, str] | None:
        """Address and identifier of the paper; None where there is none."""
        name = self.experiment.paper
        if not name:
            return None
        identifier = IDENTIFIERS.get(name, "")
        if identifier.startswith("arXiv:"):
            return f"https://arxiv.org/abs/{identifier.removeprefix('arXiv:')}", identifier
        if identifier.startswith("ISBN "):
            return f"urn:isbn:{identifier.removeprefix('ISBN ').replace('-', '')}", identifier
        return f"#paper-{name}", identifier or name


def crate(contents: Contents) -> dict[str, Any]:
    """Return the content of ro-crate-metadata.json; needs the library rocrate."""
    from rocrate.model import ContextEntity
    from rocrate.rocrate import ROCrate

    made = ROCrate(version="1.1")
    made.metadata.extra_terms["sha256"] = "https://w3id.org/ro/terms/workflow-run#sha256"

    def entity(identifier: str, kind: str, /, **properties: Any) -> Any:
        return made.add(ContextEntity(made, identifier, properties={"@type": kind, **properties}))

    for name, (digest, size) in contents.hashes.items():
        made.add_file(dest_path=name, properties=_file(name) | {"contentSize": str(size), "sha256": digest})
    made.add_file(dest_path=VERIFIED, properties=_file(VERIFIED))
    root = made.root_dataset
    root["name"], root["description"] = contents.title, _description(contents)
    root["datePublished"] = contents.finished
    root["identifier"] = f"sha256:{contents.experiment.hash}"
    root["keywords"] = ["Monte Carlo", "robust estimation", "model predictive control", contents.experiment.name]
    identifier = f"{LICENCES}{contents.licence}" if contents.licence else "#no-licence"
    root["license"] = entity(identifier, "CreativeWork", name=contents.licence or NO_LICENCE)
    profile = entity(PROFILE, "CreativeWork", name="Process Run Crate", version="0.5")
    root["conformsTo"] = profile
    people = [entity(f"#author-{number}", "Person", name=name) for number, name in enumerate(contents.authors, 1)]
    if not people:
        people = [entity("#authors", "Organization", name=UNKNOWN_AUTHORS)]
    root["author"] = root["publisher"] = _single(people)
    if contents.paper:
        address, identifier = contents.paper
        root["citation"] = entity(address, "ScholarlyArticle", name=contents.experiment.paper, identifier=identifier)
    _add_computation(made, entity, contents, people)
    generated: dict[str, Any] = made.metadata.generate()
    return generated


def stated_by(metadata: Any) -> tuple[tuple[str, ...], str]:
    """Return the authors and the licence that the content of ro-crate-metadata.json names."""
    graph = metadata.get("@graph", []) if isinstance(metadata, dict) else []
    entities = [each for each in graph if isinstance(each, dict)] if isinstance(graph, list) else []
    people = [str(each.get("name")) for each in entities if str(each.get("@id")).startswith("#author-")]
    named = [str(each.get("@id")) for each in entities]
    licences = [name.removeprefix(LICENCES) for name in named if name.startswith(LICENCES)]
    return tuple(people), (*licences, "")[0]


def _add_computation(made: Any, entity: Any, contents: Contents, people: list[Any]) -> None:
    """Describe what computed the results: program, libraries, times."""
    versions = dict(contents.manifest.get("versions", {})) | dict(contents.manifest.get("libraries", {}))
    bench = versions.pop("rmpc-bench", rmpc_bench.__version__)
    libraries = [
        entity(f"#{name}-{version}", "SoftwareApplication", name=name, version=version)
        for name, version in versions.items()
    ]
    program = entity(
        "#rmpc-bench",
        "SoftwareApplication",
        name="rmpc-bench",
        version=bench,
        description=f"arithmetic (NUMERICS) {contents.manifest.get('numerics', rmpc_bench.NUMERICS)}",
        softwareRequirements=libraries,
    )
    inputs = [name for name in contents.hashes if name in _INPUTS or _folder(name) in ("code", "data")]
    results = [name for name in contents.hashes if _folder(name) not in ("code", "data") and name not in _NO_RESULTS]
    platform = contents.manifest.get("platform", {})
    action = {
        "name": f"Computation of {contents.experiment.name}",
        "description": f"{len(contents.sessions)} sessions on {platform.get('system', 'an unknown system')}",
        "instrument": program,
        "object": _single([made.dereference(name) for name in inputs]),
        "result": [made.dereference(name) for name in results],
        "endTime": contents.finished,
        "agent": _single(people),
        "actionStatus": "http://schema.org/CompletedActionStatus",
    }
    if contents.sessions:
        action["startTime"] = min(each["start"] for each in contents.sessions)
    made.root_dataset["mentions"] = entity("#computation", "CreateAction", **action)


def _single(entities: list[Any]) -> Any:
    """Return a list, or its only element, as RO-Crate recommends."""
    return entities[0] if len(entities) == 1 else entities


def _folder(name: str) -> str:
    return name.partition("/")[0] if "/" in name else ""


def _file(name: str) -> dict[str, str]:
    kind = _TYPES.get(PurePosixPath(name).suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
    description = DESCRIPTIONS.get(name) or FOLDERS.get(_folder(name), "File of the results")
    return {"name": name, "description": description, "encodingFormat": kind}


def _description(contents: Contents) -> str:
    methods, seed = ", ".join(contents.experiment.methods), contents.experiment.points[0].seed
    text = f"{contents.n_runs} paired runs of {methods}; seed {seed}."
    if contents.incomplete:
        text += f" Incomplete: {'; '.join(contents.incomplete)}."
    return f"{text} `rmpc-bench verify` computes them again and compares them."


def citation(contents: Contents) -> str:
    """Return the citation file (CFF 1.2.0): these results, the program, and the paper whose methods they compare."""
    from rmpc_bench.config_file.yaml import dump

    bench = contents.manifest.get("versions", {}).get("rmpc-bench", rmpc_bench.__version__)
    program = {
        "type": "software",
        "title": "rmpc-bench",
        "authors": [{"name": "The rmpc-bench developers"}],
        "version": bench,
    }
    references: list[dict[str, Any]] = [program]
    if contents.paper:
        name, (_, identifier) = contents.experiment.paper, contents.paper
        paper = {"type": "generic", "title": name, "authors": [{"name": f"The authors of {name}"}]}
        references.append(paper | {"notes": identifier} if identifier != name else paper)
    return dump(
        {
            "cff-version": "1.2.0",
            "message": "If you use these results, cite them, the program, and the paper whose methods they compare.",
            "type": "dataset",
            "title": contents.title,
            "authors": [{"name": name} for name in contents.authors or (UNKNOWN_AUTHORS,)],
            "date-released": contents.finished[:10],
            **({"license": contents.licence} if contents.licence else {}),
            "references": references,
        }
    )
