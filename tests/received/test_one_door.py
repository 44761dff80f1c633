"""Files that somebody else may have made are opened in the room `received` only; read from the sources."""

import ast
import os
import subprocess
import sys

from test_architecture import FILES, calls, imports, trees

READERS = {
    "sqlite3.connect",
    "zipfile.ZipFile",
    "ZipFile",
    "zipfile.is_zipfile",
    "np.load",
    "np.loadtxt",
    "np.genfromtxt",
    "np.fromfile",
    "loadmat",
    "pd.read_csv",
    "csv.reader",
    "csv.DictReader",
    "json.load",
    "json.loads",
    "zlib.decompress",
    "pickle.load",
    "pickle.loads",
    "marshal.loads",
    "tarfile.open",
    "shutil.unpack_archive",
    "joblib.load",
}
# File -> what it opens: a table that `verify` reads from an archive which was taken out and checked.
OTHERS = {"packing/comparison.py": {"pd.read_csv"}}
# What one process of the bench sends to another, through a pipe or a temporary file of its own.
BETWEEN_OWN_PROCESSES = {
    "components/transport.py": {"pickle.loads"},
    "conformance/process.py": {"pickle.load"},
    "conformance/evaluation.py": {"pickle.loads"},
    "conformance/signals.py": {"pickle.loads"},
    "conformance/outcome.py": {"pickle.loads"},
    "conformance/information.py": {"pickle.loads"},
    "conformance/subject.py": {"pickle.loads"},
    "engines/messages.py": {"pickle.loads"},
    "engines/worker.py": {"pickle.load"},
    "execution/pilot.py": {"json.loads"},
    "execution/separation.py": {"pickle.loads"},
}


def opened(tree):
    """Return the readers that a file calls; text that it has just written itself is no file."""
    found = set()
    for text, node in calls(tree):
        writes = any(isinstance(each, ast.Constant) and each.value in ("w", "x", "a") for each in node.args[1:])
        own = bool(node.args) and isinstance(node.args[0], ast.Call) and ast.unparse(node.args[0].func) == "json.dumps"
        if text in READERS and not writes and not own:
            found.add(text)
    return found


def starts_git(tree):
    """Whether a file starts programs and has the word git."""
    words = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
    return "git" in words and any(name.startswith("subprocess") for name in imports(tree))


def test_no_other_room_opens_what_somebody_else_made():
    found = {file: opened(tree) for file, tree in trees().items() if not file.startswith("received/")}
    assert {file: names for file, names in found.items() if names} == OTHERS | BETWEEN_OWN_PROCESSES


def test_one_function_starts_git():
    files = {file for file, tree in trees().items() if starts_git(tree)}
    assert files == {"received/consent.py"}


def test_numba_reads_no_settings_of_the_current_directory(tmp_path):
    """They may come from somebody else, and name a directory of compiled code, which numba unpickles."""
    importing = {file for file, tree in trees().items() if any(name.split(".")[0] == "numba" for name in imports(tree))}
    assert importing == set()
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: ./there\nboundscheck: 1\n", encoding="utf-8")
    code = "import os; from rmpc_bench.numerics.compiled import numba; c = numba.core.config; c.reload_config()"
    code = f"{code}; print(c.CACHE_DIR, c.BOUNDSCHECK, os.getcwd())"
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["None", str(tmp_path.resolve())]


def test_nothing_is_unpickled_or_imported_in_the_room():
    text = "".join(FILES[file].read_text(encoding="utf-8") for file in FILES if file.startswith("received/"))
    assert not any(word in text for word in ("pickle.load", "import_module", "exec(", "eval(", "allow_pickle=True"))


def test_the_check_sees_a_reader():
    tree = ast.parse("import json\ndef f(p):\n    return json.loads(p.read_text()), json.loads(json.dumps(p))")
    assert opened(tree) == {"json.loads"} and opened(ast.parse("zipfile.ZipFile(p, 'w')")) == set()
    assert starts_git(ast.parse("import subprocess\nsubprocess.run(['git', 'status'])"))
