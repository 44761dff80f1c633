"""manifest.json: who computed what, and when."""

import json
from datetime import datetime, timedelta

import pytest
from small_experiment import write

from rmpc_bench import __version__, load_config
from rmpc_bench.received.consent import commit_of
from rmpc_bench.received.plain_files import DamagedError
from rmpc_bench.results import manifest
from rmpc_bench.results.manifest import session


@pytest.fixture
def config(tmp_path):
    """Return the small experiment."""
    return load_config(write(tmp_path))


def sit(directory, config, *, modified=(), error=None):
    """Go through a session and return what it said; an error may end it."""
    said = []
    try:
        with session(directory, config, modified, said.append):
            assert manifest.read(directory)["sessions"][-1]["why"] == "running"
            if error is not None:
                raise error
    except BaseException as caught:
        assert caught is error
    return said


def test_what_is_noted(tmp_path, config):
    """Hash, seed, versions, BLAS and platform, readable as JSON."""
    assert sit(tmp_path, config, modified=["-s seed=8"]) == []
    text = (tmp_path / "manifest.json").read_text()
    data = json.loads(text)
    assert text.endswith("}\n")
    assert (data["name"], data["experiment"], data["seed"]) == ("tiny", config.hash, 7)
    assert data["modified"] == ["-s seed=8"]
    assert data["versions"]["rmpc-bench"] == __version__
    assert set(data["versions"]) == {"rmpc-bench", "python", "numpy", "scipy", "numba", "joblib", "pandas"}
    assert data["blas"] and {"user_api", "internal_api", "version", "architecture"} == set(data["blas"][0])
    assert set(data["platform"]) == {"system", "machine", "cores"}
    assert [path.name for path in tmp_path.glob("manifest*")] == ["manifest.json"]


def test_a_look_during_a_session_is_kept(tmp_path, config):
    with session(tmp_path, config, [], print):
        manifest.note_look(tmp_path, 200)
        manifest.note_report(tmp_path, {"place": "x"})
    data = manifest.read(tmp_path)
    assert data["looks"] == [200] and data["report"] == {"place": "x"}
    assert data["sessions"][-1]["why"] == "finished"


def test_commit_of_the_configuration(tmp_path, config):
    """Outside a repository there is none; inside, the commit and whether it is all."""
    assert set(commit_of(tmp_path / "nowhere") or {}) <= {"commit", "dirty"}
    sit(tmp_path, config)
    git = manifest.read(tmp_path)["git"]
    assert git is None or set(git) == {"commit", "dirty"}


@pytest.mark.parametrize("error", [None, KeyboardInterrupt(), ValueError("bug")])
def test_every_session_has_an_end_and_a_reason(tmp_path, config, error):
    """Times are UTC, the reason is the exception's name."""
    sit(tmp_path, config, error=error)
    [session] = manifest.read(tmp_path)["sessions"]
    assert session["why"] == ("finished" if error is None else type(error).__name__)
    start, stop = datetime.fromisoformat(session["start"]), datetime.fromisoformat(session["stop"])
    assert start.utcoffset() == timedelta(0) and start <= stop


def test_sessions_add_up(tmp_path, config):
    """A later one keeps those before."""
    sit(tmp_path, config, error=KeyboardInterrupt())
    sit(tmp_path, config)
    assert [session["why"] for session in manifest.read(tmp_path)["sessions"]] == ["KeyboardInterrupt", "finished"]


def test_other_versions_are_said(tmp_path, config):
    """Continuing with another NumPy is allowed and announced."""
    sit(tmp_path, config)
    data = manifest.read(tmp_path)
    data["versions"]["numpy"] = "1.0"
    (tmp_path / "manifest.json").write_text(json.dumps(data))
    [said] = sit(tmp_path, config)
    assert "numpy 1.0" in said and "--fresh" in said


@pytest.mark.parametrize("text", ["", "[1]", "{", "\x00"])
def test_a_broken_manifest_is_refused(tmp_path, config, text):
    """It has the number of looks; the message says what removes it."""
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(DamagedError, match="manifest.json: .*remove the file"):
        with session(tmp_path, config, (), print):
            pass
    assert (tmp_path / "manifest.json").read_text() == text


def test_no_manifest(tmp_path):
    """It is empty."""
    assert manifest.read(tmp_path) == {}


def test_looks_are_kept_from_session_to_session(tmp_path, config):
    """Each number of runs once, in the order of time; a broken list of them is an error."""
    manifest.note_look(tmp_path, 200)
    assert manifest.looks_of_manifest(tmp_path) == []
    sit(tmp_path, config)
    for n_runs in (200, 400, 200):
        manifest.note_look(tmp_path, n_runs)
    sit(tmp_path, config)
    assert manifest.looks_of_manifest(tmp_path) == [200, 400]
    (tmp_path / "manifest.json").write_text('{"looks": 7}')
    with pytest.raises(DamagedError, match="looks: must be a list"):
        manifest.looks_of_manifest(tmp_path)
