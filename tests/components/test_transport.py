"""Own components in worker processes: made again by path, never asked whether they can be pickled."""

import pickle
import subprocess
import sys

import pytest
from own_files import ESTIMATOR, write
from small_experiment import ran

from rmpc_bench import load_config, registry, run
from rmpc_bench.components import transport
from rmpc_bench.components.transport import recipe_of

FILES = {
    "own.py": ESTIMATOR
    + """
from parts.scale import SCALE


class Lambda(Own):
    def __init__(self, model, x0, *, gain: Positive = 0.1):
        super().__init__(model, x0, gain=gain)
        self.scale = lambda x: SCALE * x
        self.lock = __import__("threading").Lock()

    def correct(self, k, state, y):
        from late import LATE
        return super().correct(k, state, self.scale(y) * LATE)


def inside(model, x0, *, gain: Positive = 0.2):
    class Local(Own):
        pass

    return Local(model, x0, gain=gain)
""",
    "parts/scale.py": "SCALE = 1.0",
    "late.py": "LATE = 1.0",
    "law.py": """
import numpy as np
from rmpc_bench import Metric, plant, single_run
from rmpc_bench.metrics.tracking import Mse
from rmpc_bench.noise.gaussian import gaussian


@single_run
class Proportional:
    def __init__(self, K: float = 2.0):
        self.K = K

    def control(self, x_hat, r):
        return self.K * (r - x_hat[:1])


def system(Ts):
    made = plant("servo-linear", Ts)
    object.__setattr__(made, "extra", lambda: 1)
    return made


def quiet(n, *, std: float = 0.01):
    return gaussian(n, std=std)


class MyMse(Mse):
    pass
""",
}
METHODS = (
    "{KF: {estimator: {kind: kalman}}, Lambda: {estimator: {file: own.py:Lambda}}, "
    "Own: {estimator: {file: own.py:Own}, controller: {file: law.py:Proportional, K: 1.5}}, "
    "Inside: {estimator: {file: own.py:inside}}, Registered: {estimator: {kind: registered}}}"
)
KEYS = {
    "methods": METHODS,
    "plant": "{file: law.py:system, perturb: {J_l: 1 + eps}}",
    "noise": "{measurement: {file: law.py:quiet, std: 0.02}}",
    "metrics": "[mse, {file: law.py:MyMse, name: mine}]",
}


@pytest.fixture
def registered(monkeypatch):
    """Register a class that no worker can import, as in a notebook; forget it afterwards."""
    monkeypatch.setattr(registry, "_REGISTERED", {group: {} for group in registry.BUILT_IN})
    scope = {"__name__": "no_module_of_a_worker"}
    monkeypatch.setitem(sys.modules, "no_module_of_a_worker", type(sys)("no_module_of_a_worker"))
    exec(ESTIMATOR, scope)
    registry.register("estimator", "registered", scope["Own"])


@pytest.mark.long
def test_two_workers_give_the_bytes_of_one(tmp_path, registered):
    """Neighbours, lambdas, a lock, a local class, a class of a notebook: whatever the block."""
    path = write(tmp_path, FILES, **KEYS)
    one = ran(path, tmp_path / "one")
    two = ran(path, tmp_path / "two", "-s", "execution.block=3", jobs=2)
    assert one == two


def test_an_edit_during_an_experiment_reaches_no_worker(tmp_path):
    """Rows of the old code would be stored with numbers of the new one."""
    path = write(tmp_path, FILES, estimator="{file: own.py:Lambda}")
    config = load_config(path)
    sent = transport.dumps([point.experiment for point in config.points])
    for name in ("own.py", "parts/scale.py", "late.py"):
        (tmp_path / name).write_text("raise SystemExit('the new text')")
    code = f"""
import pickle, sys
from rmpc_bench.components.transport import loads
(experiment,) = loads(pickle.loads({pickle.dumps(sent)!r}))
estimator = experiment.method("Own").estimator
estimator.correct(0, estimator.init(1), estimator.scale(3.0) * estimator.init(1)[:, :1])
print(estimator.scale(3.0))
"""
    # The text is longer than an argument may be where other tests have loaded files, too.
    done = subprocess.run([sys.executable, "-"], input=code, capture_output=True, text=True)
    assert done.stdout == "3.0\n", done.stderr
    assert done.stderr == ""


def test_a_process_sends_on_what_it_got_where_the_files_are_gone(tmp_path):
    """Texts that came from another process count, not the files on disk."""
    path = write(tmp_path, FILES, estimator="{file: own.py:Lambda}")
    config = load_config(path)
    sent = transport.dumps([point.experiment for point in config.points])
    for name in ("own.py", "parts/scale.py", "late.py"):
        (tmp_path / name).unlink()
    code = f"""
import pickle
from rmpc_bench.components.transport import dumps, loads
(experiment,) = loads(dumps(loads(pickle.loads({pickle.dumps(sent)!r}))))
print(experiment.method("Own").estimator.scale(3.0))
"""
    done = subprocess.run([sys.executable, "-"], input=code, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("3.0\n", "")


def test_a_recipe_ends_with_its_design(tmp_path):
    """The table of recipes does not grow with every configuration that is loaded."""
    from rmpc_bench.components import transport

    path = write(tmp_path)
    config = load_config(path)
    assert recipe_of(config.experiment.method("Own").estimator) is not None
    assert recipe_of(config.experiment.method("KF").estimator) is None
    number = len(transport._recipes)
    for _ in range(3):
        config = load_config(path)
    assert len(transport._recipes) <= number + 1


def test_designs_that_share_a_part_share_it_in_the_worker(tmp_path):
    """A model of two methods is made once."""
    files = {"law.py": "def law(Ts):\n    from rmpc_bench.models.servo import ServoNoise, design\n"
             "    return design(Ts, noise=ServoNoise(process=1.0, measurement=1.0))\n"}  # fmt: skip
    methods = "{A: {estimator: {file: own.py:Own}}, B: {estimator: {file: own.py:Own, gain: 0.2}}}"
    config = load_config(write(tmp_path, files, model="{file: law.py:law}", methods=methods))
    again = transport.loads(transport.dumps(config.experiment))
    assert again.method("A").estimator.model is again.method("B").estimator.model
    assert again.method("A").estimator is not config.experiment.method("A").estimator
    assert again.method("B").estimator.gain == 0.2


def test_results_of_a_program_with_own_classes(tmp_path, registered):
    """`run` of the Python interface, two processes, designs registered by the program itself."""
    config = load_config(write(tmp_path, estimator="{kind: registered}"))
    results = run(config, directory=tmp_path / "out", jobs=2)
    assert set(results.trials.frame["status"]) == {"ok"}


def test_a_plugin_in_worker_processes(tmp_path, monkeypatch):
    """Its class is one of a private module, which every worker loads from the texts it has received."""
    monkeypatch.setattr(registry, "_REGISTERED", {group: {} for group in registry.BUILT_IN})
    text = ESTIMATOR + "\nfrom rmpc_bench import register\nregister('estimator', 'from-plugin', Own)\n"
    path = write(tmp_path, {"plug.py": text}, estimator="{kind: from-plugin}", plugins="[plug.py]")
    config = load_config(path)
    assert config.resolved["plugins"]
    results = run(config, directory=tmp_path / "out", jobs=2)
    assert set(results.trials.frame["status"]) == {"ok"}


def test_a_package_that_an_import_hook_finds_is_sent_by_reference(monkeypatch):
    """An editable installation is such a package: its modules are not on the path of Python."""
    import sys
    from importlib.machinery import ModuleSpec
    from types import ModuleType

    from rmpc_bench.components import transport

    class Hook:
        @staticmethod
        def find_spec(name, path, target=None):
            return ModuleSpec(name, None) if name == "hooked_package" else None

    assert not transport._is_importable("hooked_package.part")
    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path, Hook])
    monkeypatch.setitem(sys.modules, "hooked_package", ModuleType("hooked_package"))
    assert transport._is_importable("hooked_package.part")
