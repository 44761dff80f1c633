"""Who may import whom, and what no module may do; read from the sources, nothing is imported."""

import ast
import re
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1] / "rmpc_bench"
FILES = {path.relative_to(ROOT).as_posix(): path for path in sorted(ROOT.rglob("*.py"))}


@cache
def trees():
    """Syntax of every file of the package."""
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in FILES.items()}


@cache
def nodes(tree):
    """Everything in a syntax tree, walked once for all tests."""
    return [*ast.walk(tree)]


DESIGNS = {"models", "numerics", "types"}
# A room may always import itself.  Arrows that need a reason have it above them.
MAY_IMPORT = {
    "types": set(),
    "expressions": set(),
    "numerics": {"types", "extras"},  # what libraries load without need
    "models": {"numerics", "types"},
    "noise": {"numerics", "types"},
    # A plant may be a recorded one.  What it draws itself has a law.
    "plants": DESIGNS | {"recordings", "noise"},
    # The files of users that a component reads itself.
    "recordings": {"types", "received"},
    "estimators": DESIGNS,
    "controllers": DESIGNS,
    "metrics": {"numerics", "types"},
    # A figure is checked with the layout of stored results, and drawn in the style in which it is saved.
    # A component is loaded and designed as in a run, and simulated with a linear system whose best filter is known.
    "conformance": {
        "analysis",
        "child_process",
        "components",
        # Keys on the command line are validated as those of a configuration.
        "config",
        "config_file",
        "figures",
        "models",
        "numerics",
        "registry",
        "simulation",
        "types",
    },
    "simulation": {"noise", "numerics", "types"},
    # The mismatch is that of an experiment, whose record (`Experiment`) belongs to the simulation.
    "diagnostics": {"simulation", "noise", "numerics", "types"},
    "notices": set(),
    "replaced_file": set(),
    "child_process": set(),
    # Everything stored or received is read here, before any room that uses it.
    # A name that is replaced or refused is said where a notebook shows it.
    "received": {"types", "replaced_file", "extras"},  # the extra that reads Parquet
    # The stored bytes: blocks and moments are those of the simulation.
    "store": {"components", "simulation", "types", "received"},
    "registry": {"notices", "types", "installed"},
    "installed": set(),
    "extras": set(),
    # A system of another library is integrated as an own equation is, and made from the designs of the bench.
    "adapters": {
        # Trials are exported.
        "analysis",
        "components",
        "estimators",
        "controllers",
        "plants",
        "models",
        "numerics",
        "types",
        "extras",
        "received",
        # Exports build a configuration and simulate its plant.
        "config",
        "simulation",
        "execution",
        "results",
        "rmpc_bench",
    },
    # A user's file is named before its code runs, for programs and notebooks too.
    "components": {"received", "registry", "installed", "extras", "notices", "types", "numerics", "models"},
    # An error is judged as by a metric.
    "analysis": {"numerics", "types"},
    "claims": {"analysis", "expressions", "types"},
    # Pictures and tables are files.
    "figures": {"analysis", "types", "replaced_file", "notices", "extras"},  # as numerics
    "report": {"figures", "claims", "analysis", "types", "replaced_file"},
    # A YAML file with the place of everything; it knows no section.
    "config_file": {
        "registry",
        "extras",  # the extra of a component that is not installed
        "components",
        "expressions",
        "simulation",  # the shape of an initial state
        "models",  # the key `disturbance` of every model
        "types",
        "received",
        "rmpc_bench",  # where the installed configurations are
    },
    # What editors and `describe` say of the keys.
    "schema": {"registry", "extras", "components", "config", "config_file", "models", "types"},
    # Keys of an uncertain quantity are the fields of its law; the noise `same` and sets of x(0) are made as laws.
    # NUMERICS is a part of the key of a trial.
    "config": {
        "config_file",
        "registry",
        "extras",
        "components",
        "expressions",
        "claims",
        "simulation",
        "diagnostics",  # whether the loop of a method is stable
        "noise",
        "models",  # the key `disturbance` of every model
        "types",
        "rmpc_bench",
        "received",
    },
    "engines": {
        "child_process",
        "components",
        "config",
        "extras",
        "simulation",
        "types",
    },
    # What a directory of results holds.  A claim is judged from it.
    "results": {
        "installed",  # versions of libraries
        "store",
        "engines",  # the type of a finished task
        "config",
        "config_file",
        "components",
        "simulation",
        "analysis",
        "claims",
        "report",
        "replaced_file",
        "received",
        "types",
        "rmpc_bench",  # for the version
    },
    "execution": {
        "results",
        "store",
        "engines",
        "child_process",
        "extras",
        "config",
        "config_file",
        "components",
        "simulation",
        "analysis",
        "claims",
        "figures",
        "report",
        "replaced_file",
        "received",
        "types",
        "numerics",  # whether compiled code is kept in a file
        "notices",  # a line of progress is one of these
        "rmpc_bench",  # for the version
        "publishing",  # a pilot measures the time of a report
    },
    # The code of a user's figure may raise anything; what a task is made of says whether own code takes part.
    "publishing": {
        "installed",  # versions of libraries
        "config",
        "config_file",
        "components",
        "store",
        "engines",
        "execution",
        "results",
        "analysis",
        "claims",
        "figures",
        "report",
        "replaced_file",
        "received",
        "types",
        "rmpc_bench",  # for the version
    },
    # Runs made elsewhere become a directory as `run` makes one; parameters must be values that their laws can have.
    "importing": {
        "analysis",  # the stored runs to which others are added
        "claims",
        "config",
        "config_file",
        "execution",  # progress.json
        "extras",
        "installed",  # versions of libraries
        "noise",
        "received",
        "registry",
        "replaced_file",
        "results",
        "simulation",
        "store",
        "types",
        "rmpc_bench",  # for the version
    },
    # Packed results are computed and published again, and compared with the packed ones.
    "packing": {
        "installed",  # versions of libraries
        "config",
        "config_file",
        "store",
        "engines",  # how the packed runs are computed again
        "execution",
        "importing",
        "results",
        "publishing",
        "analysis",
        "claims",
        "report",
        "received",
        "types",
        "rmpc_bench",  # for the version
    },
}
# The types of its public names, for type checkers; test_public_api.py asserts that its import imports nothing.
MAY_IMPORT["rmpc_bench"] = set(MAY_IMPORT)
MAY_IMPORT["cli"] = set(MAY_IMPORT)
MAY_IMPORT["__main__"] = {"cli"}
SHARED_SIBLINGS = {
    "bridging",
    "constrained",
    "gain_schedule",
    "gaussian_filter",
    "gpc_law",
    "gpc_limits",
    "gpc_rows",
    "increments",
    "input_limits",
    "limit_rows",
    "limits",
    "lqg_law",
    "mpc_law",
    "noise_tuning",
    "prediction",
    "state_feedback",
    "tube_design",
    "weighted",
}
ONLY_IN = {  # a package of others -> where it may be imported
    "matplotlib": "figures/",
    "joblib": "engines/",
    "distributed": "engines/",
    "dask": "engines/",
    "click": "cli/",
    "highspy": "numerics/lp.py",
    "daqp": "numerics/qp.py",
    "cvxpy": "nowhere",
    "quadprog": "nowhere",
    "casadi": "adapters/",
    "control": "adapters/",
    "do_mpc": "adapters/",
    "filterpy": "adapters/",
    "fmpy": "adapters/",
    "gymnasium": "adapters/",
    "stonesoup": "adapters/",
    "xarray": "adapters/",
}
BELOW_CONFIG = (
    "types/",
    "expressions/",
    "numerics/",
    "models/",
    "noise/",
    "plants/",
    "estimators/",
    "controllers/",
    "metrics/",
    "simulation/",
    "diagnostics/",
    "analysis/",
    "claims/",
)
FLOORS = {
    # From the file to designs, checks and a resolved experiment, stage by stage.
    "config": 10,
    # The kit runs checks of all kinds in a process, on examples that are simulated.
    "conformance": 10,
}
"""Longest chain of imports inside a room; 8 elsewhere."""
OUTSIDE_WORLD = {"io", "os", "pathlib", "random", "shutil", "socket", "subprocess", "tempfile", "time", "datetime"}


def room(file):
    """Return the package or top-level module that a file belongs to."""
    return file.split("/")[0].removesuffix(".py").replace("__init__", "rmpc_bench")


@cache
def imports(tree):
    """Dotted names of everything imported, inside functions too; `from a import b` gives `a.b`."""
    names = []
    for node in nodes(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def own_imports(tree):
    """(room, module) of every import from the package itself."""
    for name in imports(tree):
        package, *rest = name.split(".")
        if package == "rmpc_bench":
            known = rest and (rest[0] in MAY_IMPORT)
            yield (rest[0] if known else "rmpc_bench"), (rest[1] if known and len(rest) > 1 else "")


@cache
def calls(tree):
    """Text of everything called."""
    return [(ast.unparse(node.func), node) for node in nodes(tree) if isinstance(node, ast.Call)]


def test_imports_follow_the_arrows():
    """A room imports itself and what `MAY_IMPORT` allows it."""
    forbidden = {}
    for file, tree in trees().items():
        here = room(file)
        assert here in MAY_IMPORT, f"{file}: a new room; say in MAY_IMPORT what it may import"
        found = {there for there, _ in own_imports(tree)} - MAY_IMPORT[here] - {here}
        forbidden |= {file: sorted(found)} if found else {}
    assert not forbidden


@cache
def graph():
    """Module -> modules of the package that it imports; lazy imports count too."""
    modules = {"rmpc_bench." + file.removesuffix(".py").replace("/", "."): tree for file, tree in trees().items()}
    named = {
        module: {name if name in modules else name.rpartition(".")[0] for name in imports(tree)}
        for module, tree in modules.items()
    }
    return {module: names & set(modules) - {module} for module, names in named.items()}


def test_no_import_leads_back():
    """Modules can be read one after the other: no cycle in any room, nor between rooms."""
    assert {"rmpc_bench.config.load", "rmpc_bench.config.build"} <= set(graph())
    assert len(list(TopologicalSorter(graph()).static_order())) == len(graph())


def test_a_room_has_few_floors():
    """Longest chain of imports inside a room; what adds a floor says why in FLOORS."""
    floors = {}
    for module in TopologicalSorter(graph()).static_order():
        here = module.split(".")[1]
        below = [floors[name] for name in graph()[module] if name.split(".")[1] == here]
        floors[module] = 1 + max(below, default=0)
    high = {module: n for module, n in floors.items() if n > FLOORS.get(module.split(".")[1], 8)}
    assert not high


def test_a_method_does_not_import_its_siblings():
    """What two methods share lies in a shared file or in numerics."""
    for file, tree in trees().items():
        here = room(file)
        siblings = {module for there, module in own_imports(tree) if there == here}
        assert here not in ("estimators", "controllers") or siblings <= SHARED_SIBLINGS, file


def test_packages_stay_in_their_rooms():
    """Matplotlib, joblib, click and the solvers are imported in one place only."""
    imported = {file: {name.split(".")[0] for name in imports(tree)} for file, tree in trees().items()}
    strays = [
        (file, package)
        for file, packages in imported.items()
        for package in sorted(packages & set(ONLY_IN))
        if not file.startswith(ONLY_IN[package])
    ]
    assert strays == []


def test_below_config_nothing_touches_files_environment_or_clock():
    """No files, environment, clock or global random state below `config`."""
    found = {}
    for file in (file for file in FILES if file.startswith(BELOW_CONFIG)):
        tree = trees()[file]
        named = {text for text, _ in calls(tree)}
        random = {text for text in named if text.startswith("np.random.")}
        wrong = {name.split(".")[0] for name in imports(tree)} & OUTSIDE_WORLD
        wrong |= {"open"} & named
        wrong |= random - {"np.random.Generator", "np.random.PCG64", "np.random.SeedSequence"}
        found |= {file: sorted(wrong)} if wrong else {}
    assert found == {}


def test_compiled_code_calls_nothing_from_another_file():
    """Numba's cache, which knows the source of the caller only, would not see that such a function has changed."""
    compiled = {file for file, path in FILES.items() if "\n@compiled(" in path.read_text(encoding="utf-8")}
    assert compiled == {
        "models/moving_slide_kernel.py",
        "models/servo_kernel.py",
        "numerics/bounded_window_kernel.py",
        "numerics/game_kernel.py",
        "numerics/linear_loop_kernel.py",
        "numerics/minimax_kernel.py",
        "numerics/output_weights_kernel.py",
        "numerics/tracking_kernel.py",
    }
    strays = {file: {*own_imports(trees()[file])} - {("numerics", "compiled")} for file in compiled}
    assert not {file: names for file, names in strays.items() if names}


def test_processes_import_no_file_of_the_current_directory():
    """With -P a file `random.py` of the current directory does not run in place of the standard module."""
    starts = [
        [ast.unparse(each) for each in node.elts]
        for tree in trees().values()
        for node in nodes(tree)
        if isinstance(node, ast.List) and node.elts and ast.unparse(node.elts[0]) == "sys.executable"
    ]
    assert len(starts) >= 2
    assert all(start[1] == "'-P'" for start in starts)


def test_only_cli_and_progress_print():
    """Outside the command line, progress.py and notices.py alone print, and to stderr."""
    for file, tree in trees().items():
        prints = [node for text, node in calls(tree) if text == "print"]
        if file in ("execution/progress.py", "notices.py"):
            targets = [ast.unparse(key.value) for node in prints for key in node.keywords if key.arg == "file"]
            assert targets == ["sys.stderr"] * len(prints)
        elif not file.startswith("cli/"):
            assert not prints, file
            streams = {ast.unparse(node) for node in nodes(tree) if isinstance(node, ast.Attribute)}
            assert not streams & {"sys.stdout", "sys.stderr"}, file


def test_no_file_is_too_long():
    """500 lines at most; the message lists what is on the way there."""
    lengths = {file: len(path.read_text(encoding="utf-8").splitlines()) for file, path in FILES.items()}
    long = {file: length for file, length in lengths.items() if length > 400}
    assert max(lengths.values()) <= 500, f"longer than 400 lines: {long}"


def test_files_that_rooms_name_are_there():
    """In the docstring of a room: a file of it, or of a room that it names, or a file of the package above."""
    absent, n_named = [], 0
    for file in (file for file in FILES if file.endswith("__init__.py")):
        text = ast.get_docstring(trees()[file]) or ""
        folder = FILES[file].parent
        named = re.findall(r"(?<![\w/])(?!my_)[a-z_]+\.py\b", text)
        rooms = [folder, ROOT, *(ROOT / room for room in re.findall(r"`(\w+)`", text))]
        n_named += len(named)
        absent += [f"{file}: {name}" for name in named if not any((room / name).exists() for room in rooms)]
    assert n_named > 15 and not absent


def test_names_say_something():
    """No module is a drawer for the rest, and file names are importable as they stand."""
    stems = {path.stem for path in FILES.values()}
    assert not stems & {"utils", "util", "helpers", "helper", "common", "misc", "manager"}
    assert all(stem == stem.lower() and stem.isidentifier() for stem in stems)


def test_the_check_sees_imports_inside_functions():
    """The reading itself works: the lazy imports of the command line are found."""
    assert ("config", "load") in set(own_imports(trees()["cli/run.py"]))
