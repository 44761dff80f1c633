"""What a user may write: names of arguments, keys, marks, and what is refused with which words."""

import inspect
import pickle

import numpy as np
import pytest
from components.one_run import MODEL, Fixed, Textbook, designed

from rmpc_bench import Controller, Estimator, Metric, single_run
from rmpc_bench.components.single_run import design_function, is_single_run
from rmpc_bench.config_file.keys import keys_of, validate
from rmpc_bench.config_file.tree import Map, Mark, Problems
from rmpc_bench.registry import _REGISTERED
from rmpc_bench.types import Command, DesignError, Positive, as_command, as_estimate, as_motion


def law(**methods):
    """Make a marked controller."""
    return single_run(type("Law", (), {"control": lambda self, x_hat: 0.0, **methods}))


def filter_(**methods):
    """Make a marked estimator."""
    return single_run(type("Mine", (), {"update": lambda self, y: y, **methods}))


class Plain:
    """A class that is not marked."""

    def update(self, y):
        """Return y."""
        return y


class Nothing:
    """A class that is no component."""


REFUSED = {
    "misspelt": ("controllers", law(control=lambda self, xhat: 0), "Law.control: 'xhat' is not a known argument; did"),
    "nearest": ("estimators", filter_(update=lambda self, y, u_prev: 0), "did you mean 'u_previous'?"),
    "default": ("estimators", filter_(update=lambda self, y, gain=1.0: 0), "'gain' is not a known argument"),
    "elsewhere": (
        "estimators",
        filter_(update=lambda self, y, x: 0),
        "update cannot have the argument 'x'; its arguments may be y, u",
    ),
    "all": ("controllers", law(control=lambda self, *args: 0), "Law.control takes *arguments; name every argument"),
    "keys": ("controllers", law(__init__=lambda self, **keys: None), "takes **keys; name every key"),
    "no class method": ("controllers", law(prepare=lambda self, model: 0), "Law.prepare must be a class method"),
    "reserved": ("controllers", law(__init__=lambda self, max_held=1: None), "'max_held' is a key of every single-run"),
    "method": ("estimators", law(), "has the method update or predict and correct; Law has not"),
    "near method": ("estimators", single_run(type("M", (), {"updat": lambda self, y: y})), "did you mean 'update'?"),
    "half": ("estimators", single_run(type("M", (), {"predict": lambda self, u: u})), "predict and correct; M has not"),
    "no mark": ("estimators", Plain, "Plain is not marked: write @single_run above the class if it is written for one"),
    "nothing": (
        "estimators",
        Nothing,
        "Nothing is no estimator: mark it with @single_run, or derive it from",
    ),
    "other base": ("estimators", Controller, "Controller is a Controller, no estimator"),
    "object": ("estimators", 3.0, "an estimator is a class or a function; this is an object of type float"),
    "function": (
        "estimators",
        single_run(lambda y: y),
        "an estimator written for one run is a class; this is a",
    ),
    "group": ("references", single_run(lambda k: k), "single_run marks estimators, controllers, plants, metrics;"),
}


def test_a_method_that_is_there_is_not_taken_for_a_misspelt_one():
    """Oracle: the sentence; only `ouput` is near to a method that is missing."""
    plant = single_run(type("Tank", (), {"step": lambda self, x, u: x, "ouput": lambda self, x: x}))
    with pytest.raises(DesignError) as error:
        design_function("plants", plant)
    assert str(error.value).endswith("Tank has not: 'ouput' is not a known method; did you mean 'output'?")


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name):
    """Oracle: the sentence, before any run, without an object made."""
    group, component, message = REFUSED[name]
    with pytest.raises(DesignError) as error:
        design_function(group, component)
    assert message in str(error.value) and error.value.parameter == "kind"


def test_functions_and_batch_classes_are_their_own_design_functions():
    """Oracle: identity."""

    def design(model):
        """Return nothing."""

    class Batch(Estimator):
        """An estimator of many runs."""

    assert design_function("estimators", design) is design and design_function("estimators", Batch) is Batch


@pytest.fixture
def registered():
    """Return a function that registers a component for the duration of a test."""
    names = []

    def add(group, component):
        _REGISTERED[group]["mine"] = design_function(group, component)
        names.append(group)
        return keys_of(group, "mine", _REGISTERED[group]["mine"])

    yield add
    for group in names:
        del _REGISTERED[group]["mine"]


@single_run
class Tuned(Fixed):
    """A filter with keys.

    Parameters
    ----------
    gain : how much of the innovation counts
    Ne : samples
    """

    def __init__(self, model, Ts, gain: Positive, Ne: int = 3):
        self.gain = gain


def test_parameters_of_init_are_keys(registered):
    """Oracle: the problems of a built-in component: missing, unknown, out of range, quantities, defaults."""
    problems = Problems()
    kind = registered("estimators", Tuned)
    mark = Mark("x.yaml", 1, 1)
    checked = problems.tried(validate, kind, Map({"gain": "2*pi", "max_held": "5%"}, mark=mark), ["e"])
    assert problems == [] and (checked.gain, checked.Ne, checked.on_failure, checked.max_held) == (
        2 * np.pi,
        3,
        "stop",
        0.05,
    )
    for tree, message in (
        ({"gain": 0.0}, "must be > 0"),
        ({"gain": 1.0, "gian": 1.0}, "did you mean 'gain'?"),
        ({"gain": 1.0, "on_failure": "holds"}, "must be 'stop' or 'hold'"),
        ({}, "gain"),
    ):
        problems.clear()
        assert problems.tried(validate, kind, Map(tree, mark=mark), ["e"]) is None
        assert message in problems[0].message
    text = inspect.getdoc(design_function("estimators", Tuned))
    assert text.startswith("A filter with keys.") and "gain : how much" in text and "max_held : share" in text


def test_the_marked_class_stays_usable():
    """Oracle: an object made by hand; a derived class counts as marked, too."""
    textbook = Textbook(MODEL)
    textbook.start(np.zeros(2), np.eye(2))
    assert textbook.update(np.zeros(1), None)[0].tolist() == [0.0, 0.0]

    class Derived(Textbook):
        """Nothing new."""

    assert is_single_run(Textbook) and is_single_run(Derived) and not is_single_run(Plain)


def test_keyword_arguments_static_methods_and_dataclasses():
    """Oracle: the numbers, whatever way the method takes them."""
    from dataclasses import dataclass

    @single_run
    @dataclass
    class Law:
        K: float = 2.0

        @staticmethod
        def control(k, *, x_hat, r):
            return r[0] - x_hat[0] + k

    design = designed("controllers", Law, K=3.0)
    estimate = as_estimate(np.array([[0.25, 0.0]]))
    command = design.control(2, design.init(1), np.zeros((1, 1)), estimate, np.ones((1, 1)))[1]
    assert command.u.tolist() == [[2.75]] and design.keys == {"K": 3.0}


def test_a_design_can_be_pickled_without_what_was_prepared():
    """Oracle: the same answers; what `prepare` returned stays in its process."""
    design = designed("estimators", Textbook)
    again = pickle.loads(pickle.dumps(design))
    y = np.ones((2, 1))
    first, second = (each.correct(0, each.init(2), y)[1] for each in (design, again))
    np.testing.assert_array_equal(first.x_hat, second.x_hat)
    assert again._prepared is None


class Batch(Estimator):
    """A batch class with as little as there can be."""

    def init(self, n_runs):
        """Nothing to remember."""

    def correct(self, k, state, y):
        """Return x_hat alone."""
        return state, np.tile(y, (1, 2))

    def predict(self, k, state, u):
        """Do nothing."""


class BatchLaw(Controller):
    """A law that returns u alone."""

    def init(self, n_runs):
        """Nothing to remember."""

    def control(self, k, state, y, estimate, r):
        """Return the reference."""
        return state, np.tile(r[0], (len(y), 1))


def test_subclasses_of_the_base_classes_get_every_default():
    """Oracle: x_hat = y, u = 1, statuses OK, nothing reported; the simulation takes arrays alone."""
    from components.one_run import experiment, simulated

    status, _, traces, _ = simulated(experiment(Batch(), BatchLaw()))
    assert not status.any() and (traces["u"] == 1.0).all()
    assert (as_estimate(np.zeros((3, 2))).P, as_command(np.zeros((3, 1))).info) == (None, {})
    assert (
        as_motion(np.zeros((3, 1))).status.tolist()
        == [0, 0, 0]
        == Command(np.zeros((3, 1)))._replace(status=np.zeros(3, dtype=np.int8)).status.tolist()
    )


def test_the_base_classes_are_public():
    """Oracle: the ones of the bench; there is no second family."""
    from rmpc_bench import types

    assert (Estimator, Controller, Metric) == (types.Estimator, types.Controller, types.Metric)


class Warns(Batch):
    """A batch class with a floating-point warning and a small number."""

    def correct(self, k, state, y):
        """Warn; an underflow is no warning."""
        np.sqrt(np.full(len(y), -1.0))
        np.exp(np.full(len(y), -800.0))
        return super().correct(k, state, y)


def test_warnings_of_batch_classes_are_counted():
    """Oracle: one text, once per sample."""
    from components.one_run import N, experiment, simulated

    (journal,) = simulated(experiment(Warns()))[3]
    ((text, count),) = journal.warnings.items()
    assert text.startswith("RuntimeWarning: invalid value encountered in sqrt (test_single_run.py:") and count == N + 1
