"""Base classes: the defaults of every capability, and the ways to replace one."""

import inspect
import pickle
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
import pytest
from simulation.toy import Halfway, Proportional, Walk

from rmpc_bench.types import Controller, Estimator, Method, Model, Noise, Plant, Reference, attribute
from rmpc_bench.types.basics import Keyword, takes, values_of

DEFAULTS = {
    Plant: {
        "y_unit": "",
        "u_unit": "",
        "units": {},
        "nominal": {},
        "remarks": (),
        "cost_per_step": 0.0,
        "mixes_noise": False,
        "has_period": False,
        "opponent": None,
        "has_singular_poses": False,
        "extra_signals": {},
        "has_between": False,
        "system": None,
    },
    Estimator: {
        "knows_uncertainty": False,
        "estimates_mean": False,
        "estimates_set": False,
        "reports": {},
        "remarks": (),
        "cost_per_step": 0.0,
        "Ne": 0,
        "form": None,
        "x0": None,
        "P": None,
        "P_is": "covariance",
        "M": None,
        "sets": None,
        "uncertainty_scale": None,
        "gain_schedule": None,
    },
    Controller: {
        "preview": 1,
        "regulates": False,
        "reports": {},
        "remarks": (),
        "cost_per_step": 0.0,
        "certifies": False,
        "optimises": False,
        "input_limits": None,
    },
    Model: {"varies": False, "is_linear_model": False, "has_sets": False, "S": 0.0},
    Noise: {"mean": None, "cov": None, "has_bursts": False, "burst_names": ()},
}


@pytest.mark.parametrize(
    ("base", "name", "value"), [(base, *item) for base, values in DEFAULTS.items() for item in values.items()]
)
def test_every_capability_has_a_default(base, name, value):
    """Oracle: the table above; an instance of the base class itself has the value."""
    assert getattr(base(), name) == value


def test_methods_have_defaults():
    """Oracle: nothing is drawn, plotted, reported, unreachable or known before any run; warming up does nothing."""
    plant, w, v = Plant(), np.ones((2, 3, 1)), np.zeros((2, 3, 1))
    assert plant.mix(None, w, v) == (w, v)
    assert plant.drawn(None) == {} and plant.facts() == [] and plant.plots() == ()
    assert plant.period(0) is None and plant.linear({}) is None and plant.unreachable(np.zeros((3, 1))) is None
    assert Estimator().series() == {} and Controller().series() == {}
    assert Controller().linear_law() is None
    assert [each().warm_up() for each in (Plant, Estimator, Controller, Model)] == [None] * 4
    rng = np.random.default_rng(1)
    assert Noise().burst_values(rng) == {} and not Noise().in_burst(rng, 4).any()


@pytest.mark.parametrize(
    "call",
    [
        lambda: Plant().draw({}, [], 1),
        lambda: Plant().step(0, None, None, None, None),
        lambda: Plant().output(0, None, None, None),
        lambda: Plant().against(()),
        lambda: Plant().manipulability(None),
        lambda: Plant().nx,
        lambda: Plant().Ts,
        lambda: Estimator().init(1),
        lambda: Estimator().correct(0, None, None),
        lambda: Estimator().predict(0, None, None),
        lambda: Controller().init(1),
        lambda: Controller().control(0, None, None, None, None),
        lambda: Controller().certificate(0, None, 1),
        lambda: Model().at(0),
        lambda: Noise().draw(None, 1),
        lambda: Reference().sample(1),
    ],
)
def test_what_a_subclass_must_define_has_no_default(call):
    """Oracle: NotImplementedError."""
    with pytest.raises(NotImplementedError):
        call()


def test_noises_come_one_per_state_and_output():
    """Oracle: nw = nx and nv = ny unless a plant says otherwise."""

    class Two(Plant):
        nx, nu, ny = 3, 1, 2

    assert (Two().nw, Two().nv) == (3, 2)


@dataclass(frozen=True)
class Fields(Plant):
    """A frozen design whose capabilities are fields, one with a default, or class attributes."""

    Ts: float
    nominal: dict
    remarks: tuple = ("a remark",)
    nx: int = field(default=5, init=False)

    y_unit = "m"


class Assigned(Plant):
    """A plant that assigns a capability in its constructor."""

    def __init__(self):
        self.nominal = {"a": 1.0}


class Computed(Estimator):
    """An estimator whose capabilities are properties."""

    @property
    def reports(self):
        """One number."""
        return {"r": ()}


def test_a_capability_is_replaced_in_any_way():
    """Oracle: the values given; a field without a default does not get that of the base class."""
    made = Fields(0.1, {"b": 2.0})
    assert (made.Ts, made.nominal, made.remarks, made.nx, made.y_unit) == (0.1, {"b": 2.0}, ("a remark",), 5, "m")
    assert made.u_unit == "" and made.nw == 5
    with pytest.raises(TypeError, match="nominal"):
        Fields(0.1)
    assert Assigned().nominal == {"a": 1.0} and Plant().nominal == {}
    assert Computed().reports == {"r": ()}
    assert pickle.loads(pickle.dumps(made)) == made


def test_the_class_itself_has_no_value():
    """Oracle: AttributeError, so that a dataclass finds no default; the documentation is that of the function."""

    class Shape:
        @attribute
        def sides(self):
            """Count the sides."""
            return 0

    with pytest.raises(AttributeError, match="sides"):
        _ = Shape.sides
    assert vars(Shape)["sides"].__doc__ == "Count the sides." and Shape().sides == 0


def test_a_method_reports_what_its_components_report():
    """Oracle: both mappings; shapes become tuples."""

    class Reporting(Halfway):
        reports = MappingProxyType({"r": [2]})

    class Tuned(Proportional):
        reports = MappingProxyType({"Q": (2, 2), "loss": ()})

    assert Method("m", Reporting(), Tuned()).reports == {"r": (2,), "Q": (2, 2), "loss": ()}
    assert Method("m", Halfway(), Proportional()).reports == {}
    assert isinstance(Walk(), Plant)


def test_a_model_takes_sizes_and_noises_of_its_linear_model(small_model):
    """Oracle: those of the model at k = 0; its sets are zero."""

    class Own(Model):
        def at(self, k):
            return small_model

    own = Own()
    assert (own.nx, own.nu, own.ny) == (3, 2, 2)
    for ours, theirs in (
        (own.Q_w, small_model.Q_w),
        (own.R_v, small_model.R_v),
        (own.w_law[0], np.zeros(3)),
        (own.w_law[1], small_model.Q_w),
        (own.v_law[0], np.zeros(2)),
        (own.v_law[1], small_model.R_v),
        (own.M_w(2), np.zeros((3, 3))),
        (own.M_v(2), np.zeros((2, 2))),
    ):
        np.testing.assert_array_equal(ours, theirs)


def test_a_design_function_takes_shared_keywords():
    """Oracle: the signature and the docstring by hand; a misspelt keyword is an error."""
    shared = {"m": Keyword(float, 2.0, "mass [kg]")}

    @takes(shared)
    def make(Ts, *, noise=0.0, **parameters):
        """Make.

        parameters : those of the system
        """
        return values_of(shared, parameters)

    assert str(inspect.signature(make)) == "(Ts, *, noise=0.0, m: float = 2.0)"
    assert make.__doc__.splitlines()[-1] == "m : mass [kg]"
    assert make(0.1) == {"m": 2.0} and make(0.1, m=3) == {"m": 3.0}
    with pytest.raises(TypeError, match="unknown keywords: mm"):
        make(0.1, mm=3.0)
