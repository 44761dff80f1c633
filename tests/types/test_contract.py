"""Checks of a design: the same for built-in, registered and installed components, reported at the key `kind`."""

import sys
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import random_model
from simulation.toy import Halfway, Proportional, Walk
from small_experiment import write

from rmpc_bench import load_config, registry
from rmpc_bench.config_file import factories
from rmpc_bench.estimators import kalman
from rmpc_bench.figures.boxplot import Boxplot
from rmpc_bench.metrics.tracking import Mse
from rmpc_bench.types import (
    ConfigError,
    Controller,
    DesignError,
    Estimator,
    Figure,
    GainSchedule,
    LinearLaw,
    Metric,
    Model,
    Noise,
    Plant,
    Reference,
)
from rmpc_bench.types.contract import BASES, checked

MODEL = random_model(np.random.default_rng(1), 3, 2, 2)


def without(base, kind, name):
    """Return a component of a kind that has lost a method: it has the one of the base class."""
    return type("Lost", (kind,), {name: vars(base)[name]})()


def changed(kind, **values):
    """Return a component of a kind with other attributes."""
    return type("Changed", (kind,), values)()


@dataclass(frozen=True)
class Scheduled(Estimator):
    """An estimator that declares a gain schedule."""

    schedule: GainSchedule

    init = correct = predict = Halfway.init

    @property
    def gain_schedule(self):
        """Return it."""
        return self.schedule


class Declared(Proportional):
    """A controller that declares a linear law."""

    def __init__(self, *gains):
        self.gains = gains

    def linear_law(self):
        """Return it."""
        return LinearLaw(*self.gains)


class Steps(Reference):
    """A reference of one output."""

    def sample(self, n_samples):
        """Count."""
        return np.arange(n_samples)[:, None]


class Signs(Noise):
    """A noise of one component."""

    def draw(self, rng, n_samples):
        """Draw signs."""
        return np.sign(rng.standard_normal((n_samples, 1)))


class Wrong(Model):
    """A model that gives another number of states than its linear model has."""

    nx = 2

    def at(self, k):
        """Return a model of three states."""
        return MODEL


SCHEDULE = kalman.design(MODEL, 2, x0=np.zeros(3), P0=np.eye(3)).gain_schedule
LAW = (np.zeros((2, 3)), np.eye(2), np.zeros((2, 2)))
GIVEN = {"model": MODEL}
GOOD = [
    ("plants", Walk(), {}),
    ("models", MODEL, {}),
    ("estimators", Halfway(), {}),
    ("estimators", Scheduled(SCHEDULE), GIVEN),
    ("controllers", Proportional(), {}),
    ("controllers", Declared(*LAW), GIVEN),
    ("references", Steps(), {"ny": 1}),
    ("noises", Signs(), {"n": 1}),
    ("metrics", Mse(), {}),
    ("figures", Boxplot(), {}),
]
BAD = [
    ("plants", {}, {}, "an object of type dict; a design function must return an instance of Plant"),
    ("estimators", Halfway, {}, "the class Halfway; a design function must return an instance of Estimator"),
    ("estimators", None, {}, "an object of type NoneType; a design function must return an instance of Estimator"),
    ("controllers", Halfway(), {}, "an object of type Halfway; a design function must return an instance of Contr"),
    ("models", SimpleNamespace(), {}, "must return an instance of Model"),
    ("references", 3.0, {}, "must return an instance of Reference"),
    ("noises", 3.0, {}, "must return an instance of Noise"),
    ("metrics", 3.0, {}, "must return an instance of Metric"),
    ("figures", object(), {}, "must return an instance of Figure"),
    ("plants", Plant(), {}, "does not define nx, nu, ny, Ts, draw, step, output"),
    ("plants", without(Plant, Walk, "step"), {}, "does not define step"),
    ("estimators", without(Estimator, Halfway, "predict"), {}, "does not define predict"),
    ("controllers", without(Controller, Proportional, "control"), {}, "does not define control"),
    ("models", Model(), {}, "does not define at"),
    ("noises", Noise(), {}, "does not define draw"),
    ("references", Reference(), {}, "does not define sample"),
    ("metrics", Metric(name="m"), {}, "does not define evaluate"),
    ("figures", Figure(), {}, "does not define draw"),
    ("plants", changed(Walk, nx=0), {}, "nx must be an integer of 1 or more (got 0)"),
    ("plants", changed(Walk, nw=1.5), {}, "nw must be an integer of 0 or more (got 1.5)"),
    ("plants", changed(Walk, Ts=0.0), {}, "Ts must be a positive number of seconds (got 0.0)"),
    ("plants", Walk(a=None), {}, "the nominal value of a must be a number (got None)"),
    (
        "models",
        replace_size := changed(type("Own", (Model,), {"at": lambda self, k: MODEL}), nx=2),
        {},
        "Q_w has shape",
    ),
    ("estimators", changed(Halfway, reports={"r": 2}), {}, "reports must map 'r' to the shape"),
    ("estimators", changed(Halfway, Ne=-1), {}, "Ne must be an integer of 0 or more (got -1)"),
    ("estimators", changed(Halfway, x0=np.zeros(2)), GIVEN, "x0 has shape (2,); (3,) fits"),
    ("estimators", changed(Halfway, P=np.eye(3)), GIVEN, "P has shape (3, 3); (3, 3, 3) fits"),
    ("estimators", Scheduled(SCHEDULE._replace(K=np.zeros((1, 2, 2)))), GIVEN, "K of its gain schedule has shape"),
    ("controllers", changed(Proportional, preview=-1), {}, "preview must be an integer of 0 or more (got -1)"),
    ("controllers", changed(Proportional, reports={"Q": "2"}), {}, "reports must map 'Q' to the shape"),
    ("controllers", Declared(LAW[0][:1], *LAW[1:]), GIVEN, "K_x of its linear law has shape (1, 3); (2, 3) fits"),
    ("references", Steps(), {"ny": 2}, "sample(2) has shape (2, 1); (2, 2) fits"),
    ("noises", Signs(), {"n": 2}, "a draw of 2 samples has shape (2, 1); (2, 2) fits"),
    ("noises", changed(Signs, mean=np.zeros(2)), {"n": 1}, "mean has shape (2,); (1,) fits"),
    ("noises", changed(Signs, cov=np.zeros(1)), {"n": 1}, "cov has shape (1,); (1, 1) fits"),
]


@pytest.mark.parametrize(("group", "made", "provided"), GOOD)
def test_a_sound_component_is_returned(group, made, provided):
    """Oracle: the same object."""
    assert checked(group, "mine", made, provided) is made


@pytest.mark.parametrize(("group", "made", "provided", "message"), BAD)
def test_what_is_wrong_is_named(group, made, provided, message):
    """Oracle: group, kind and reason in the message; the key to blame is `kind`."""
    with pytest.raises(DesignError) as caught:
        checked(group, "mine", made, provided)
    assert str(caught.value).startswith(f"the {group.removesuffix('s')} 'mine'") and message in str(caught.value)
    assert caught.value.parameter == "kind"


def registered(monkeypatch, group, design):
    """Make a design known as a program does."""
    monkeypatch.setattr(registry, "_REGISTERED", {each: {} for each in registry.BUILT_IN})
    registry.register(group, "mine", design)


def installed(monkeypatch, group, design):
    """Make a design known as an installed package does."""
    point = SimpleNamespace(name="mine", load=lambda: design)
    monkeypatch.setattr(registry, "_entry_points", lambda asked: {"mine": point} if asked == group else {})


def built_in(monkeypatch, group, design):
    """Put a design in the place of a built-in one."""
    monkeypatch.setitem(registry.BUILT_IN[group], "mine", "somewhere:design")
    monkeypatch.setitem(sys.modules, "somewhere", SimpleNamespace(design=design))


def design_plant(Ts: float):
    """Return no plant."""
    return {}


def design_estimator(model, n_steps, *, x0, P0):
    """Return no estimator."""
    return {}


def design_controller(model):
    """Return no controller."""
    return {}


def design_metric():
    """Return no metric."""
    return {}


def design_figure():
    """Return no figure."""
    return {}


PLACES = {
    "plants": ("plant.kind", design_plant, {"plant": "{kind: mine}"}),
    "estimators": ("methods.M.estimator.kind", design_estimator, {"methods": "{M: {estimator: {kind: mine}}}"}),
    "controllers": ("controller.kind", design_controller, {"controller": "{kind: mine}"}),
    "metrics": ("metrics[0].kind", design_metric, {"metrics": "[{kind: mine}]"}),
    "figures": ("figures[0].kind", design_figure, {"figures": "[{kind: mine}]"}),
}


@pytest.mark.parametrize("known", [registered, installed, built_in])
@pytest.mark.parametrize("group", PLACES)
def test_all_components_of_a_configuration_pass_the_checks(group, known, tmp_path, monkeypatch):
    """Oracle: one located error, whichever way the component has become known."""
    place, design, keys = PLACES[group]
    known(monkeypatch, group, design)
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, uncertainty="{}", **({"plant": "{kind: servo-linear}"} | keys)))
    (problem,) = caught.value.problems
    assert problem.path.endswith(place.split(".", 1)[1]) and problem.line > 1
    noun = group.removesuffix("s")
    assert problem.message.startswith(f"the {noun} 'mine' is an object of type dict; a design function must return")


@pytest.mark.parametrize("group", ["plants", "models", "estimators", "controllers"])
def test_a_component_built_by_name_passes_the_checks(group, monkeypatch):
    """Oracle: the verbs of the Python interface raise the same error."""
    registered(monkeypatch, group, lambda *args: {})
    with pytest.raises(DesignError, match=f"must return an instance of {BASES[group].__name__}"):
        getattr(factories, group.removesuffix("s"))("mine")
