"""Build the documentation site: ``python -m docs.site OUT`` (or ``make site-docs``) writes OUT/docs and OUT/site."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from docs.site.markup import commonmark, math
from docs.site.pages import Site
from docs.site.tree import navigation, site

HERE = Path(__file__).parent
MODULES = Path(sys.prefix) / "share" / "site-docs" / "node_modules"
"""Where `make site-setup` installs what is not ours."""
THIRD_PARTY = {
    "iframe-worker.js": "iframe-worker/shim/index.js",
    "iframe-worker-LICENSE.txt": "iframe-worker/LICENSE",
    "math.woff2": "@fontsource/stix-two-math/files/stix-two-math-latin-400-normal.woff2",
    "math-LICENSE.txt": "@fontsource/stix-two-math/LICENSE",
}
"""File of the site -> file of a package: the search of a site that is opened as files, and a font for formulas."""


def write(made: Site, out: Path) -> None:
    """Write the sources of the site and mkdocs.yml."""
    docs = out / "docs"
    shutil.rmtree(docs, ignore_errors=True)
    for path in made.texts:
        (docs / path).parent.mkdir(parents=True, exist_ok=True)
        (docs / path).write_text(commonmark(math(made.linked(path))), encoding="utf-8")
    files = {**made.images, "extra.css": HERE / "extra.css"}
    files |= {name: MODULES / file for name, file in THIRD_PARTY.items() if (MODULES / file).exists()}
    for name, file in files.items():
        if file.exists():
            (docs / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, docs / name)
    settings = (HERE / "mkdocs.yml").read_text(encoding="utf-8")
    (out / "mkdocs.yml").write_text(f"{settings}nav: {json.dumps(navigation(made), indent=1)}\n", encoding="utf-8")


def main(out: Path) -> int:
    """Write the sources and build the site; what is missing is said in one line each."""
    made = site()
    write(made, out)
    for link in made.lost:
        print(f"no page of the site has {link}", file=sys.stderr)
    if not all((MODULES / file).exists() for file in THIRD_PARTY.values()):
        print("without iframe-worker (search in files) and STIX Two Math: `make site-setup` needs npm", file=sys.stderr)
    print(f"{len(made.texts)} pages in {out / 'docs'}", flush=True)
    command = Path(sys.executable).with_name("zensical")
    if not command.exists():
        print("zensical is not installed: make site-setup", file=sys.stderr)
        return 1
    return subprocess.run(
        [command, "build", "--strict"], cwd=out, env={**os.environ, "NO_COLOR": "1"}
    ).returncode or bool(made.lost)


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1])))
