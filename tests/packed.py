"""Archives of results for tests: altered ones, and the check of the RO-Crate without a network."""

import hashlib
import json
import zipfile
from importlib.resources import files
from types import SimpleNamespace


def contents(path):
    """Read all files of an archive."""
    with zipfile.ZipFile(path) as file:
        return {name: file.read(name) for name in file.namelist()}


def write(path, names):
    """Write an archive with these files."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in names.items():
            file.writestr(name, content)
    return path


def metadata(names):
    """Return the description of files with their hashes."""
    graph = [{"@id": name, "sha256": hashlib.sha256(content).hexdigest()} for name, content in names.items()]
    return json.dumps({"@graph": graph}).encode()


def altered(path, to, *, honest=False, **changes):
    """Copy an archive with other contents of some files; `honest` states the hashes of the new contents."""
    found = contents(path)
    for name, change in changes.items():
        file = name.replace("__", ".")
        found[file] = change(found[file])
    if honest:
        metadata = json.loads(found["ro-crate-metadata.json"])
        for entity in metadata["@graph"]:
            if "sha256" in entity:
                entity["sha256"] = hashlib.sha256(found[entity["@id"]]).hexdigest()
                entity["contentSize"] = str(len(found[entity["@id"]]))
        found["ro-crate-metadata.json"] = (json.dumps(metadata, indent=2, ensure_ascii=False) + "\n").encode()
    return write(to, found)


def crate_issues(path, profile, monkeypatch):
    """Return what roc-validator requires of an archive and does not find.

    The JSON-LD context, which the validator would download, is the one that the library rocrate has.
    """
    from rocrate_validator import models, services
    from rocrate_validator.utils.http import HttpRequester

    context = files("rocrate").joinpath("data/ro-crate.jsonld").read_text("utf-8")

    def get(self, url, **options):
        found = "w3id.org/ro/crate" in url
        return SimpleNamespace(
            status_code=200 if found else 404,
            headers={"Content-Type": "application/ld+json"},
            json=lambda: json.loads(context),
            text=context,
            content=context.encode(),
            url=url,
        )

    monkeypatch.setattr(HttpRequester, "get", get, raising=False)
    monkeypatch.setattr(HttpRequester, "head", get, raising=False)
    settings = services.ValidationSettings(
        rocrate_uri=str(path), profile_identifier=profile, requirement_severity=models.Severity.REQUIRED
    )
    return [issue.message for issue in services.validate(settings).get_issues()]
