"""A browser without a window: it types a query into the search of a site that is opened as files."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
OPTIONS = "--headless --no-sandbox --disable-gpu --remote-debugging-pipe".split()
FOUND = """(function f(root) {
  let found = [...root.querySelectorAll('a')].map(a => a.href).filter(h => h.includes('?h='));
  for (const e of root.querySelectorAll('*')) if (e.shadowRoot) found = found.concat(f(e.shadowRoot));
  return found;
})(document)"""
"""Addresses of the results that are shown, in their order."""
LOCAL = ("file:", "data:", "about:", "blob:")


class Browser:
    """Chromium by its debugging protocol, which it speaks through its files 3 and 4.

    Attributes
    ----------
    asked : every address that it asked for
    """

    def __init__(self, profile: Path) -> None:
        command = [
            "sh",
            "-c",
            'exec "$@" 3<&0 4>&1',
            "sh",
            PROGRAM or "chromium",
            *OPTIONS,
            f"--user-data-dir={profile}",
        ]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, bufsize=0
        )
        self.asked: list[str] = []
        self._rest, self._count = b"", 0
        self._session: dict[str, str] = {}
        page = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = {"sessionId": self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]}
        self.call("Network.enable")

    def close(self) -> None:
        """End the program."""
        self._process.kill()
        self._process.wait()
        for pipe in filter(None, (self._process.stdin, self._process.stdout)):
            pipe.close()

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command and return its result."""
        assert self._process.stdin and self._process.stdout
        self._count += 1
        command = {"id": self._count, "method": method, "params": params, **self._session}
        self._process.stdin.write(json.dumps(command).encode() + b"\0")
        while True:
            while b"\0" not in self._rest:
                read = self._process.stdout.read(1 << 16)
                assert read, "the browser has ended"
                self._rest += read
            first, _, self._rest = self._rest.partition(b"\0")
            message = json.loads(first)
            if message.get("method") == "Network.requestWillBeSent":
                self.asked.append(message["params"]["request"]["url"])
            if message.get("id") == self._count:
                return dict(message["result"])

    def value(self, expression: str) -> Any:
        """Value of an expression of JavaScript as soon as it is the same twice and not empty, after 20 s as it is."""
        last, value = None, None
        for _ in range(50):
            found = self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"]
            last, value = value, found.get("value")
            if value and value == last:
                break
            time.sleep(0.4)
        return value

    def results(self, site: Path, query: str) -> list[str]:
        """Paths of the pages that the search shows, in their order, each once."""
        self.call("Page.navigate", url=f"file://{site}/index.html")
        self.value("document.readyState == 'complete' && !!document.querySelector('.md-search__button')")
        self.call("Runtime.evaluate", expression="document.querySelector('.md-search__button').click()")
        time.sleep(0.5)
        self.call("Input.insertText", text=query)
        found = [each.partition("?")[0].removeprefix(f"file://{site}/") for each in self.value(FOUND) or ()]
        return list(dict.fromkeys(found))
