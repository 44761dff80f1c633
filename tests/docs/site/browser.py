"""A browser without a window: it types a query into the search of a site that is opened as files."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any

PROGRAM = shutil.which("chromium")
FOUND = """(function f(root) {
  let found = [...root.querySelectorAll('a')].map(a => a.href).filter(h => h.includes('?h='));
  for (const e of root.querySelectorAll('*')) if (e.shadowRoot) found = found.concat(f(e.shadowRoot));
  return found;
})(document)"""
"""Addresses of the results that are shown, in their order."""
LOCAL = ("file:", "data:", "about:", "blob:")


class Browser:
    """Chromium by its debugging protocol, through two pipes.

    Attributes
    ----------
    asked : every address that it asked for
    """

    def __init__(self, profile: Path) -> None:
        (answers, output), (commands, self._input) = os.pipe(), os.pipe()
        self.asked: list[str] = []
        self._answers, self._rest, self._count, self._session = answers, b"", 0, ""
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (commands, output)]
        options = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--remote-debugging-pipe",
            f"--user-data-dir={profile}",
        ]
        command = ["bash", "-c", f'exec "$@" 3<&{ends[0]} 4>&{ends[1]}', "bash", PROGRAM or "chromium", *options]
        self._process = subprocess.Popen(command, pass_fds=ends, stderr=subprocess.DEVNULL)
        for end in (commands, output, *ends):
            os.close(end)
        page = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Network"):
            self.call(f"{domain}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._input)
        os.close(self._answers)

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command and return its result."""
        self._count += 1
        session = {"sessionId": self._session} if self._session else {}
        os.write(
            self._input, json.dumps({"id": self._count, "method": method, "params": params, **session}).encode() + b"\0"
        )
        while True:
            message = self._message()
            if message.get("method") == "Network.requestWillBeSent":
                self.asked.append(message["params"]["request"]["url"])
            if message.get("id") == self._count:
                return dict(message["result"])

    def _message(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            read = os.read(self._answers, 1 << 16)
            assert read, "the browser has ended"
            self._rest += read
        first, _, self._rest = self._rest.partition(b"\0")
        return dict(json.loads(first))

    def value(self, expression: str) -> Any:
        """Value of an expression of JavaScript."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def results(self, site: Path, query: str) -> list[str]:
        """Paths of the pages that the search shows, in their order, each once."""
        self.call("Page.navigate", url=f"file://{site}/index.html")
        self._wait("document.readyState == 'complete' && !!document.querySelector('.md-search__button')")
        time.sleep(0.5)
        self.value("document.querySelector('.md-search__button').click()")
        time.sleep(0.5)
        self.call("Input.insertText", text=query)
        found = [each.partition("?")[0].removeprefix(f"file://{site}/") for each in self._wait(FOUND)]
        return list(dict.fromkeys(found))

    def _wait(self, expression: str) -> Any:
        """Value of an expression as soon as it is the same twice and not empty, after 20 s as it is."""
        last, value = None, None
        for _ in range(50):
            last, value = value, self.value(expression)
            if value and value == last:
                break
            time.sleep(0.4)
        return value or []
