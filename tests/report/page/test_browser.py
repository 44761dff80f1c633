"""The page in headless Chromium: no request, no error of the policy, the script's state, and the width of a phone."""

import http.server
import json
import re
import shutil
import subprocess
import threading

import pytest

from rmpc_bench.report.page.context import page_context
from rmpc_bench.report.page.rendering import render_html
from rmpc_bench.report.summary import summarise

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
OPTIONS = (
    "--headless --no-sandbox --disable-gpu --disable-background-networking --disable-component-update "
    "--disable-sync --no-first-run --virtual-time-budget=3000"
).split()
# A starting browser takes seconds, on a busy machine ten times as many.
pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="Chromium is not installed")]
PROBE = """<script>
addEventListener("load", () => setTimeout(() => {
  const of = (q) => [...document.querySelectorAll(q)], shown = (e) => e.getClientRects().length > 0;
  document.title = JSON.stringify({
    wide: document.documentElement.scrollWidth - innerWidth,
    rows: of("table.rows tbody tr").filter(shown).map((row) => row.dataset.method),
    parts: of("svg [data-method='B']").filter((part) => getComputedStyle(part).display !== "none").length,
    buttons: of(".tools button, th button").length,
    more: of("table.rows .more").filter(shown).length,
    words: document.body.innerText.split(/\\s+/).length,
    intervals: document.body.innerText.match(/\\[[^\\]a-z]+, [^\\]a-z]+\\]/g),
    answer: document.querySelector(".answer").getBoundingClientRect().bottom,
    table: document.querySelector("table.rows tbody").getBoundingClientRect().bottom,
    back: getComputedStyle(document.body).backgroundColor,
    hash: location.hash,
  });
}, 200));
</script>"""


def browse(directory, address, *options):
    """Open an address in a browser; the result has the page after its scripts in stdout and the log in stderr."""
    command = [BROWSER, *OPTIONS, f"--user-data-dir={directory / 'profile'}", *options, "--dump-dom", address]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)


def visited(directory, page, *options, fragment="", probe=PROBE):
    """Open the page with a script of the test, and return what that script has found."""
    # The policy allows the script of the page alone, so that the test has to take it away.
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page).replace("</body>", f"{probe}</body>")
    file = directory / "probed.html"
    file.write_text(text, encoding="utf-8")
    title = re.search(r"<title>(.*?)</title>", browse(directory, f"{file.as_uri()}{fragment}", *options).stdout, re.S)[
        1
    ]
    return json.loads(title.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))


def framed(directory, page, width, script):
    """Return what an expression finds in a page as wide as a phone; the browser has no window below 500 pixels."""
    (directory / "page.html").write_text(page, encoding="utf-8")
    style = f"width: {width}px; height: 900px; border: 0"
    frame = f"""<!DOCTYPE html><iframe id="f" src="page.html" style="{style}"></iframe><body><title></title><script>
      addEventListener("load", () => {{
        const inner = document.getElementById("f").contentDocument;
        document.title = JSON.stringify(({script})(inner));
      }});</script></body>"""
    return visited(directory, frame, "--allow-file-access-from-files", probe="")


@pytest.fixture
def page(make_source):
    return render_html("page.html", page_context(make_source()))


@pytest.mark.parametrize("width", [400, 1280])
def test_no_page_is_wider_than_its_window(tmp_path, page, width):
    script = "({documentElement: root}) => root.scrollWidth - root.clientWidth"
    assert framed(tmp_path, page, width, script) <= 0


def test_cells_of_a_matrix_are_apart_on_a_phone(tmp_path, make_trials, make_sweep, make_source):
    """Also seven columns of long numbers, which have small letters; the table fits into the window."""
    factors = {"A": 1000.0, "B": 63.0, "C": 65.0, "D": 990.0, "E": 77.0, "F": 66.0, "oracle": 0.16}
    points = []
    for k in range(6):
        columns = {name: [factor * (1 + k + run / 9) for run in range(30)] for name, factor in factors.items()}
        points.append(({"noise": f"point{k}"}, make_trials({"mse": columns})))
    trials = make_sweep(*points)
    source = make_source(trials=trials, tables=summarise(trials), verdicts=[], differences={}, figures=[])
    script = """(inner) => {
      const table = inner.querySelector("table.matrix"), range = inner.createRange();
      const box = (cell) => (range.selectNodeContents(cell), range.getBoundingClientRect());
      const gaps = [...table.tBodies[0].rows].flatMap((row) => [...row.cells].slice(1)
        .map((cell, k) => box(cell).left - box(row.cells[k]).right));
      return { cells: gaps.length, gap: Math.min(...gaps), right: table.getBoundingClientRect().right };
    }"""
    found = framed(tmp_path, render_html("page.html", page_context(source)), 400, script)
    assert found["cells"] == 42 and found["gap"] >= 0 and found["right"] <= 400


def test_the_first_screen(tmp_path, page):
    """Answer and table stand on it, columns on demand are not shown, and the interval stands twice."""
    found = visited(tmp_path, page, "--window-size=1280,900")
    assert found["wide"] <= 0 and found["answer"] <= 300 and found["table"] <= 900 and found["more"] == 0
    assert found["rows"] == ["A", "B"] and found["buttons"] == 4 and found["words"] < 400
    assert all(found["intervals"].count(text) <= 2 for text in found["intervals"])


def test_the_fragment_holds_the_state(tmp_path, make_trials, make_source):
    values = [1.0 + k / 9 for k in range(30)]
    trials = make_trials({"mse": {"A": values, "B": [0.8 * x for x in values], "c,d": [0.9 * x for x in values]}})
    three = make_source(trials=trials, tables=summarise(trials), verdicts=[], differences={})
    page = render_html("page.html", page_context(three))
    found = visited(tmp_path, page, fragment="#hide=c%252Cd&sort=1")
    assert found["rows"] == ["B", "A"] and found["hash"] == "#hide=c%252Cd&sort=1"
    assert visited(tmp_path, page, fragment="#sort=1")["rows"] == ["B", "c,d", "A"]
    assert visited(tmp_path, page, fragment="#hide=B")["parts"] == 0 < visited(tmp_path, page)["parts"]
    assert visited(tmp_path, page, fragment="#claims")["hash"] == "#claims"


def test_nothing_is_lost_without_a_script(tmp_path, page):
    with_script = visited(tmp_path, page)
    without = visited(tmp_path, re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL))
    assert without["rows"] == with_script["rows"] and abs(without["words"] - with_script["words"]) <= 15
    assert without["buttons"] == 0


def test_dark_mode(tmp_path, page):
    light = visited(tmp_path, page, "--blink-settings=preferredColorScheme=1")["back"]
    dark = visited(tmp_path, page, "--blink-settings=preferredColorScheme=0")["back"]
    assert light == "rgb(255, 255, 255)" != dark


def requests_of(directory, text):
    """Open a page through a proxy; return the addresses that the proxy was asked for, and what the browser has said."""
    seen = []

    class Proxy(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            seen.append(self.path)
            self.send_error(404)

        do_CONNECT = do_GET

        def log_message(self, *args):
            pass

    file = directory / "page.html"
    file.write_text(text, encoding="utf-8")
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Proxy) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        proxy = f"--proxy-server=127.0.0.1:{server.server_address[1]}"
        done = browse(directory, file.as_uri(), proxy, "--enable-logging=stderr", "--v=0")
        server.shutdown()
        thread.join()
    # The browser itself may ask for its updates.
    return [path for path in seen if "google" not in path and "gstatic" not in path], done


def test_the_page_makes_no_request(tmp_path, page):
    """A proxy that all requests go through sees none, and the policy blocks nothing of the page."""
    seen, done = requests_of(tmp_path, page)
    assert seen == [] and "Content Security Policy" not in done.stderr
    assert "copy table</button>" in done.stdout, "the script has run"


def test_the_proxy_sees_a_request_that_is_made(tmp_path, page):
    """So that the test above can fail; with the policy of the page the same picture is not asked for."""
    picture = page.replace("</body>", '<img src="http://pictures.test/a.png" alt=""></body>')
    assert requests_of(tmp_path, picture)[0] == []
    free = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", picture)
    assert requests_of(tmp_path, free)[0] == ["http://pictures.test/a.png"]
