"""docs/python.ipynb in a kernel: what its cells show, a class that crashes, an interrupted cell that goes on."""

import os
import re
import signal
import threading
import time
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

pytestmark = pytest.mark.long("notebook")  # they share one kernel
ROOT = Path(__file__).parents[2]
MOST = 3000
GROWTH = 10_000
"""Bytes of stored trials after which the last cell is stopped."""


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """Run the cells; the last one is stopped, asked what is stored, and run again.  Return cells and these answers."""
    place = tmp_path_factory.mktemp("notebook")
    notebook = nbformat.read(ROOT / "docs" / "python.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("PYTHONPATH", str(ROOT))
        patched.setenv("JUPYTER_PLATFORM_DIRS", "1")
        client = NotebookClient(notebook, timeout=60, resources={"metadata": {"path": str(place)}})
        with client.setup_kernel():
            for number, cell in enumerate(notebook.cells[:-1]):
                client.execute_cell(cell, number)
            last = notebook.cells[-1]
            kernel = client.km.provisioner.process.pid
            button = threading.Thread(target=_stop, args=(kernel, place / "many"), daemon=True)
            button.start()
            with pytest.raises(CellExecutionError, match="KeyboardInterrupt"):
                client.execute_cell(last, len(notebook.cells) - 1)
            button.join()
            stored = [
                _asked(client, notebook, "done = []\n" + last.source.replace("=True", "=lambda *n: done.append(n)"))
            ]
            stored.append(_asked(client, notebook, "print(done[0][0], done[-1])"))
    return notebook.cells, stored, place


def _stop(kernel, directory):
    """Do what the button of a notebook does, once the store has grown by the first trials."""
    while not (directory / "progress.json").exists():
        time.sleep(0.02)
    store = directory / "trials.sqlite"
    before = store.stat().st_size
    while store.stat().st_size < before + GROWTH:
        time.sleep(0.02)
    os.kill(kernel, signal.SIGINT)


def _asked(client, notebook, source):
    """Run a further cell and return the text that it shows."""
    notebook.cells.append(nbformat.v4.new_code_cell(source))
    cell = client.execute_cell(notebook.cells[-1], len(notebook.cells) - 1)
    notebook.cells.pop()
    return "".join(each.get("text", "") or each.get("data", {}).get("text/plain", "") for each in cell.outputs)


def outputs(cell, kind):
    return [each["data"][kind] for each in cell.outputs if kind in each.get("data", {})]


def test_there_are_twelve_cells_that_show_short_texts(executed):
    cells, _, place = executed
    assert len(cells) == 12
    for cell in cells:
        for output in cell.get("outputs", ()):
            texts = [output.get("text", ""), *(v for k, v in output.get("data", {}).items() if k != "image/svg+xml")]
            assert all(len(text) <= MOST for text in texts), cell.source
    # The other trials are in a temporary store.
    assert [path.name for path in place.iterdir()] == ["many"]


def test_tables_are_html_and_figures_svg(executed):
    cells = executed[0]
    assert outputs(cells[1], "text/plain") == ["<ExperimentConfig 'filters': 2 methods, 20 runs, 1 point>"]
    for number in (2, 3, 7):
        [html] = outputs(cells[number], "text/html")
        assert html.startswith("<table>") and ("mine" in html) == (number == 7) and "robust" in html
        [text] = outputs(cells[number], "text/plain")
        assert "\n" not in text
    [svg] = outputs(cells[4], "image/svg+xml")
    assert "<svg" in svg and "</svg>" in svg
    assert all("<table" in outputs(cells[number], "text/html")[0] for number in (5, 10))
    assert outputs(cells[9], "text/plain")[0].startswith("<Estimates: x_hat (100, 2), P (100, 2, 2), e (100, 1)")


def test_a_crash_is_a_warning_and_can_be_raised(executed):
    cells = executed[0]
    text = "".join(each.get("text", "") for each in cells[7].outputs if each.get("name") == "stderr")
    assert "20 of 20 runs of 'fragile' crashed: ZeroDivisionError: no gain at k = 8" in text and "replay(" in text
    assert [each["text"] for each in cells[8].outputs] == ["run 0: no gain at k = 8\n"]


def test_an_interrupted_cell_goes_on(executed):
    _, (shown, counted), _ = executed
    assert "1000 runs of 1 methods" in shown
    before, done, total = map(int, re.match(r"(\d+) \((\d+), (\d+), 'filters'\)", counted).groups())
    assert 0 < before < done == total == 1000
