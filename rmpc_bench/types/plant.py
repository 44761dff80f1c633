"""Base class of plants, simulated for many runs at once, and the nominal data of a plant that a component may know."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.types.basics import Array, Design, attribute
from rmpc_bench.types.exogenous import InputSignal
from rmpc_bench.types.ode import Ode
from rmpc_bench.types.records import CompiledPlant, LinearPlant, Motion, Period
from rmpc_bench.types.run_info import RunInfo
from rmpc_bench.types.signals import NamedSignals

States: TypeAlias = Float[Array, "runs nx"]
Inputs: TypeAlias = Float[Array, "runs nu"]
Outputs: TypeAlias = Float[Array, "runs ny"]
Noises: TypeAlias = Float[Array, "runs _"]
"""nw process noises or nv measurement noises of every run."""
StateSteps: TypeAlias = Float[Array, "runs steps nx"]
InputSteps: TypeAlias = Float[Array, "runs steps nu"]
ParameterValues: TypeAlias = Mapping[str, Float[Array, " runs"]]
"""Values of the parameters of every run, by name."""
Generators: TypeAlias = Sequence[np.random.Generator]
"""One generator per run."""


class Line(NamedTuple):
    """A curve of a panel."""

    label: str
    x: Float[Array, " points"]
    y: Float[Array, " points"]
    """NaN makes a gap."""
    dots: bool = False
    """Whether the points are marked instead of joined."""
    notes: tuple[str, ...] = ()
    """What is written beside the points, one text each; nothing unless given."""


class Panel(NamedTuple):
    """A plot of a plant, such as its friction law (`Plant.plots`)."""

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]
    equal: bool = False
    """Whether a unit is as long on both axes, as in a plan."""


class RecordedRuns(NamedTuple):
    """The recorded runs of a plant; their inputs take the place of a controller."""

    input: InputSignal
    n_runs: int
    """Number of recorded runs."""
    gaps: str
    """Where measurements are missing, in words; empty where none are."""
    scale: float
    """Largest magnitude of a recorded number, at least 1."""


class Plant(Design):
    """The true system: a frozen design that moves the states of many runs.

    A subclass gives the sizes `nx`, `nu`, `ny`, or `signals`, the sampling time `Ts` and the methods `draw`, `step` and
    `output`.  Everything else has a default.

    Examples
    --------
    >>> class Tank(Plant):
    ...     nx = nu = ny = 1
    ...     Ts = 1.0
    ...     def draw(self, parameters, rngs, n_steps): return None
    ...     def step(self, k, delta, x, u, w): return Motion(0.9 * x + u + w)
    ...     def output(self, k, delta, x, v): return x + v
    >>> Tank().step(0, None, np.ones((1, 1)), 0.5, 0.0).x.tolist()
    [[1.4]]
    """

    @attribute
    def nx(self) -> int:
        """Number of states; those of `signals` unless a plant says otherwise."""
        return _named(self, "nx")

    @attribute
    def nu(self) -> int:
        """Number of inputs; those of `signals` unless a plant says otherwise."""
        return _named(self, "nu")

    @attribute
    def ny(self) -> int:
        """Number of outputs; those of `signals` unless a plant says otherwise."""
        return _named(self, "ny")

    @attribute
    def Ts(self) -> float:
        """Sampling time [s]."""
        raise NotImplementedError("Ts")

    @attribute
    def nw(self) -> int:
        """Number of process noises, one per state unless a plant says otherwise."""
        return self.nx

    @attribute
    def nv(self) -> int:
        """Number of measurement noises, one per output unless a plant says otherwise."""
        return self.ny

    @attribute
    def y_unit(self) -> str:
        """Unit of all outputs; empty where there is none or where outputs differ in it (see `units`)."""
        return ""

    @attribute
    def u_unit(self) -> str:
        """Unit of all inputs; empty where there is none or where inputs differ in it (see `units`)."""
        return ""

    @attribute
    def units(self) -> Mapping[str, str]:
        """Units of single components, counted from 0, such as ``{"y.2": "rad"}``; by default those of `signals`."""
        return {} if self.signals is None else self.signals.component_units()

    @attribute
    def names(self) -> Mapping[str, str]:
        """Names of single components, such as ``{"y.0": "level"}``; by default those of `signals`."""
        return {} if self.signals is None else self.signals.component_names()

    @attribute
    def nominal(self) -> Mapping[str, float]:
        """Parameters that `perturb` and `set` may name, with their nominal values."""
        return {}

    @attribute
    def starts_runs(self) -> bool:
        """Whether `start` is called before the first sample of every block and method."""
        return False

    @attribute
    def mixes_noise(self) -> bool:
        """Whether `step` and `output` take the noises that `mix` returns; `output` then is the true output plus v."""
        return False

    @attribute
    def has_period(self) -> bool:
        """Whether `period` describes the plant, which then is linear."""
        return False

    @attribute
    def feedthrough(self) -> bool:
        """Whether y(k) depends on u(k), the input that acts; `output` then takes it as a further argument."""
        return (self.ode is not None and self.ode.fed) or (self.system is not None and "D" in self.system.active)

    @attribute
    def draws_steps(self) -> bool:
        """Whether `draw` adds random values that change from step to step and are not among those of `drawn`."""
        return False

    @attribute
    def opponent(self) -> tuple[str, float] | None:
        """Method that an adversary works against, and the largest norm of its F; None without an adversary."""
        return None

    @attribute
    def has_singular_poses(self) -> bool:
        """Whether `manipulability` is defined."""
        return False

    @attribute
    def system(self) -> Any:
        """Uncertain matrices of the plant (`models.uncertain_system.UncertainSystem`); None where it has none."""
        return None

    @attribute
    def recorded(self) -> RecordedRuns | None:
        """The runs of a plant that replays recorded ones; None for a plant that is simulated."""
        return None

    @attribute
    def has_own_start(self) -> bool:
        """Whether `first_state` gives x(0) by itself, so that `initial.x` has no meaning."""
        return self.recorded is not None

    @attribute
    def limitations(self) -> tuple[str, ...]:
        """Sentences on what a comparison with this plant cannot show; reports list them."""
        return ()

    @attribute
    def ode(self) -> Ode | None:
        """The differential equation of the plant with its nominal parameters; None where it has none."""
        return None

    @attribute
    def signals(self) -> NamedSignals | None:
        """Names, units and bounds of states, inputs and outputs; None where they have no names.

        `plant.bounds` may then name inputs: `step` gets them within their bounds.
        """
        return self.ode

    @property
    def limits_inputs(self) -> bool:
        """Whether an input has a bound, so that u(k) may differ from what the controller returns."""
        return self.signals is not None and self.signals.limits_inputs

    def applied_inputs(self, u: Inputs, runs: RunInfo | None = None) -> Float[Array, "runs nu"]:
        """Return what acts on the plant: the input of the controller within the bounds of `signals`."""
        return self.signals.limited_inputs(u, runs) if self.signals is not None and self.limits_inputs else u

    @attribute
    def extra_signals(self) -> Mapping[str, str]:
        """Signals besides x, y and u that metrics and records may name, such as a shaft torque: name -> unit."""
        return {}

    def extra_signal(self, name: str, delta: Any, x: Float[Array, "runs samples nx"]) -> Float[Array, "runs samples"]:
        """Return a signal of `extra_signals`, one number per sample, with the parameters of every run.

        Parameters
        ----------
        name : of the signal
        delta : what `draw` or `start` has returned
        x : states of every run
        """
        raise NotImplementedError("extra_signal")

    @attribute
    def has_between(self) -> bool:
        """Whether `between` is defined; otherwise the states are known at the samples only."""
        return False

    def between(
        self, delta: Any, x: StateSteps, u: InputSteps, parts: int, first: int = 0
    ) -> Float[Array, "runs steps parts nx"]:
        """Return the states at `parts` equally spaced times of every control period; see `has_between`.

        The last time of a period is its end, without the process noise.

        Parameters
        ----------
        delta : what `draw` or `start` has returned
        x : states at the beginning of successive periods
        u : inputs of these periods
        parts : number of times per period
        first : time index k of the first period
        """
        raise NotImplementedError("between")

    @abstractmethod
    def draw(self, parameters: ParameterValues, rngs: Generators, n_steps: int) -> Any:
        """Fix what is uncertain for a block of runs.

        Parameters
        ----------
        parameters : (runs,) values of every name in `nominal`
        rngs : one generator per run, for what the configuration cannot name
        n_steps : number of control periods N

        Returns
        -------
        The record ``delta``, axis 0 = run, that `step` and `output` take.
        """
        raise NotImplementedError("draw")

    def start(self, delta: Any, x0: States, runs: RunInfo) -> Any:
        """Return the record ``delta`` of one method, with what the plant keeps of every run; see `starts_runs`."""
        return delta

    def first_state(self, delta: Any, x0: States) -> States:
        """Return x(0): the one of the section `initial` unless a recorded run has its own."""
        return x0

    @abstractmethod
    def step(self, k: int, delta: Any, x: States, u: Inputs, w: Noises) -> Motion:
        """Move to x(k+1)."""
        raise NotImplementedError("step")

    @abstractmethod
    def output(self, k: int, delta: Any, x: States, v: Noises) -> Outputs:
        """Measure y(k)."""
        raise NotImplementedError("output")

    @attribute
    def has_compiled_form(self) -> bool:
        """Whether `compiled_form` gives the plant as compiled functions for the compiled simulation."""
        return False

    def compiled_form(self, delta: Any, n_steps: int) -> CompiledPlant:
        """Return the functions with which the compiled simulation repeats `step` and `output`, bit for bit.

        Parameters
        ----------
        delta : what `draw` has returned
        n_steps : number of control periods N
        """
        raise NotImplementedError("compiled_form")

    def mix(
        self, delta: Any, w: Float[Array, "runs samples nw"], v: Float[Array, "runs samples nv"]
    ) -> tuple[Float[Array, "runs samples mw"], Float[Array, "runs samples mv"]]:
        """Pass w and v of all samples k = 0..N through the uncertain matrices of every run."""
        return w, v

    def drawn(self, delta: Any) -> Mapping[str, Float[Array, " runs"]]:
        """Constants that `draw` added to the named quantities of a run, by name; they are stored beside them."""
        return {}

    def laws(self) -> Mapping[str, Any]:
        """Laws of values of `drawn` that are independent of each other and of all else, by name.

        They are objects of `rmpc_bench.noise.distributions`; comparisons are adjusted for these quantities.
        """
        return {}

    def period(self, k: int) -> Period | None:
        """Matrices of the period at k, for exact ensemble moments; None where the uncertainty is not white."""
        return None

    @attribute
    def A_c(self) -> Float[Array, "nx nx"] | None:
        """A of x' = A x + B u at the nominal parameters, of which a period is a sample; None of any other plant."""
        return None

    def linear(self, parameters: Mapping[str, float]) -> LinearPlant | None:
        """Sample the linear part of the plant for `check --deep`; None where there is none for these parameters."""
        return None

    def against(self, worst: tuple[Array, ...]) -> Plant:
        """Return the plant with the sequences (samples, r, s) of F that its adversary has found."""
        raise NotImplementedError("against")

    def unreachable(self, r: Float[Array, "samples ny"]) -> str | None:
        """Describe where a reference leaves the workspace or meets a singular pose; None where it does not."""
        return None

    def manipulability(self, y: Float[Array, "poses ny"]) -> Float[Array, " poses"]:
        """Smallest singular value of the map from output velocities to drive velocities; 0 in a singular pose."""
        raise NotImplementedError("manipulability")

    def facts(self) -> list[tuple[str, str]]:
        """Properties of the plant that are known before any run, as (label, text); `describe` prints them."""
        return []

    def plots(self) -> tuple[Panel, ...]:
        """Panels that show the plant itself, such as its friction; `describe --plot` draws them."""
        return ()


def _named(plant: Plant, size: str) -> int:
    """Return the number of states, inputs or outputs of a plant whose signals have names."""
    if plant.signals is None:
        raise NotImplementedError(size)
    return int(getattr(plant.signals, size))


class SignalLimits(NamedTuple):
    """Lower and upper limits of the signals of the plant; infinite where there is none."""

    u: tuple[Float[Array, " nu"], Float[Array, " nu"]]
    x: tuple[Float[Array, " nx"], Float[Array, " nx"]]


class PlantInfo(NamedTuple):
    """Sizes, names, units and nominal parameters of the plant."""

    nx: int
    nu: int
    ny: int
    Ts: float
    states: tuple[str, ...]
    """Names; ``x.0``, ``x.1``, .. where the plant has none."""
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: Mapping[str, str]
    """Name of a signal, or of a component such as ``y.2`` -> unit."""
    parameters: Mapping[str, float]
    """Nominal values of what `perturb` and `set` may name."""
    limits: SignalLimits

    @classmethod
    def of(cls, plant: Plant) -> PlantInfo:
        """Read a plant."""
        own = plant.signals
        names = (own.states, own.inputs, own.outputs) if own else (_numbered(plant, signal) for signal in "xuy")
        units = {**plant.units, **(own.units if own else {})}
        units |= {name: unit for name, unit in (("y", plant.y_unit), ("u", plant.u_unit)) if unit}
        u, x = (own.limits(own.inputs), own.limits(own.states)) if own else (_free(plant.nu), _free(plant.nx))
        states, inputs, outputs = names
        nominal = {name: float(value) for name, value in plant.nominal.items()}
        sizes = plant.nx, plant.nu, plant.ny, float(plant.Ts)
        return cls(*sizes, states, inputs, outputs, units, nominal, SignalLimits(_locked(u), _locked(x)))


def _numbered(plant: Plant, signal: str) -> tuple[str, ...]:
    return tuple(f"{signal}.{i}" for i in range(int(getattr(plant, f"n{signal}"))))


def _locked(limits: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return limits that cannot be changed: all runs have the same."""
    low, high = (np.array(each) for each in limits)
    for each in (low, high):
        each.setflags(write=False)
    return low, high


def _free(n: int) -> tuple[Array, Array]:
    return np.full(n, -np.inf), np.full(n, np.inf)
