"""Random inputs of one run (parameters, initial state, noises) and the reference; their draws for a block of runs.

Each random quantity has its own stream.  The stream depends on (seed, run, name) only: never on the method, the block,
the worker or the number of runs, so that every method has the same plants and the same noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.noise.distributions import UncertainLaw
from rmpc_bench.noise.gaussian import Gaussian
from rmpc_bench.numerics.linalg import as_covariance, as_vector, psd_sqrt
from rmpc_bench.simulation.random_streams import Streams, first_uniforms, generators, stream
from rmpc_bench.simulation.state_range import StateRange
from rmpc_bench.types import (
    Array,
    DesignError,
    Method,
    Metric,
    MetricInfo,
    MetricLayout,
    Noise,
    Plant,
    Reference,
    does_not_fit,
)


class RunParameter:
    """A plant parameter as a function of the named uncertain values of a run."""

    def __call__(self, values: Mapping[str, float]) -> float:
        """Return the parameter of one run."""
        raise NotImplementedError("__call__")

    def of_runs(self, columns: Mapping[str, Array], n_runs: int) -> Float[Array, " runs"]:
        """Return the parameters of many runs from (runs,) named values, those of `__call__` bit for bit."""
        return one_by_one(self, columns, n_runs)


def one_by_one(
    parameter: Callable[[Mapping[str, float]], float], columns: Mapping[str, Array], n_runs: int
) -> Float[Array, " runs"]:
    """Call a function of the named values of a run for every run."""
    lists = {name: values.tolist() for name, values in columns.items()}
    return np.array([parameter({name: each[row] for name, each in lists.items()}) for row in range(n_runs)])


initial_covariance = as_covariance
"""Expand a number (times the identity), a diagonal or a matrix to P(0); configurations do not import numerics."""


def initial_state(value: float | list[float] | Array, n: int) -> Float[Array, " n"]:
    """Expand a number (in every coordinate) or one per coordinate."""
    x = as_vector(value, n)
    if not np.isfinite(x).all():
        raise DesignError(f"must be finite (got {', '.join(f'{each:g}' for each in x)})")
    return x


@dataclass(frozen=True, eq=False)
class Scenario:
    """The random and the given parts of an experiment, the same for every method.

    Parameters
    ----------
    seed : seed of all streams
    uncertainty : law of every named quantity, or group of quantities
    parameters : plant parameters that depend on them, each a function of the named values of a run
    x0 : the true initial state (nx,) but for its deviation
    x0_noise : the terms of its deviation from that; their sum acts
    process, measurement : the terms of w and v; their sum acts, and after it those that alter a measurement, in order
    reference : what the output is meant to follow
    cross : (nv, nw) matrix T; T (w - mean of w) is added to v, for a cross-covariance; None for independent noises
    input : the laws between the input that is chosen and the one that acts, in order

    Examples
    --------
    >>> import rmpc_bench
    >>> rmpc_bench.load_config("quickstart").experiment.scenario.quantities
    ('eps_min', 'eps_max', 'eps_jl')
    """

    seed: int
    uncertainty: Mapping[str, UncertainLaw]
    parameters: Mapping[str, Callable[[Mapping[str, float]], float]]
    x0: Float[Array, " nx"]
    x0_noise: tuple[Noise, ...]
    process: tuple[Noise, ...]
    measurement: tuple[Noise, ...]
    reference: Reference
    cross: Float[Array, "nv nw"] | None = None
    input: tuple[Noise, ...] = ()

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the uncertain quantities."""
        return tuple(name for key, law in self.uncertainty.items() for name in law.names(key))

    def named_values(self, run: int) -> dict[str, float]:
        """Draw the named uncertain quantities of one run."""
        return {name: float(values[0]) for name, values in self.named_columns(range(run, run + 1)).items()}

    def named_columns(self, runs: range) -> dict[str, Float[Array, " runs"]]:
        """Draw the named uncertain quantities of many runs."""
        found: dict[str, Array] = {}
        for key, law in self.uncertainty.items():
            p = [first_uniforms(self.seed, runs, f"uncertainty/{name}").tolist() for name in law.streams(key)]
            rows = np.array([law.draw(each) for each in zip(*p, strict=True)])
            found |= zip(law.names(key), np.ascontiguousarray(rows.T), strict=True)
        return found

    def draw(self, plant: Plant, runs: range, n_steps: int) -> Draws:
        """Draw a block of runs.

        Parameters
        ----------
        plant : receives the parameters and may draw more
        runs : indices of the runs
        n_steps : number of control periods N
        """
        n_samples = n_steps + 1  # y(N) may depend on w(N)
        w = self._sum(self.process, "w", runs, n_samples, plant.nw)
        v = self._sum(self.measurement, "v", runs, n_samples, plant.nv)
        if self.cross is not None:
            deviation = w - sum(term.mean for term in self.process if term.mean is not None)
            v += np.einsum("ij,rkj->rki", self.cross, deviation)
        return Draws(
            delta=self.draw_delta(plant, runs, n_steps),
            x0=self._initial_states(runs),
            w=w,
            v=v,
            bursts=self._in_burst(runs, n_samples),
            alterations=self._alterations("v", self.measurement, runs, n_samples),
            inputs=self._alterations("u", self.input, runs, n_samples),
        )

    def draw_delta(self, plant: Plant, runs: range, n_steps: int) -> Any:
        """Let the plant draw what is uncertain; the same call gives the same numbers."""
        columns, n_runs = self.named_columns(runs), len(runs)
        parameters = {
            name: self._parameter(name, columns, n_runs) if name in self.parameters else np.full(n_runs, nominal)
            for name, nominal in plant.nominal.items()
        }
        return plant.draw(parameters, Streams(self.seed, runs, "delta"), n_steps)

    def _parameter(self, name: str, columns: Mapping[str, Array], n_runs: int) -> Float[Array, " runs"]:
        parameter = self.parameters[name]
        if isinstance(parameter, RunParameter):
            return parameter.of_runs(columns, n_runs)
        return one_by_one(parameter, columns, n_runs)

    @property
    def burst_names(self) -> tuple[str, ...]:
        """Names of what random bursts draw for a run; where several laws have some, the channel and the term first."""
        return tuple(f"{prefix}{each}" for prefix, _, law in self._random_bursts() for each in law.burst_names)

    def burst_values(self, run: int) -> dict[str, float]:
        """Draw where the random bursts of one run lie."""
        return {
            f"{prefix}{each}": value
            for prefix, name, law in self._random_bursts()
            for each, value in law.burst_values(stream(self.seed, run, name)).items()
        }

    def noise_laws(self, nw: int, nv: int) -> tuple[Array, Array] | None:
        """Mean and covariance of [w; v]; None where those of a law are not known, or where a law is not white."""
        w, v = _moments(self.process, nw), _moments(self.measurement, nv)
        if w is None or v is None or not all(law.is_white for law in (*self.process, *self.measurement)):
            return None
        (w_bar, W), (v_bar, V) = w, v
        T = np.zeros((nv, nw)) if self.cross is None else self.cross
        joint = np.block([[W, W @ T.T], [T @ W, V + T @ W @ T.T]])
        return np.concatenate([w_bar, v_bar]), joint

    def initial_law(self) -> tuple[Array, Array] | None:
        """Mean and covariance of the true initial state; None where those of a law are not known."""
        deviation = _moments(self.x0_noise, len(self.x0))
        return None if deviation is None else (self.x0 + deviation[0], deviation[1])

    def _initial_states(self, runs: range) -> Float[Array, "runs nx"]:
        x0 = np.tile(self.x0, (len(runs), 1))
        for number, term in enumerate(self.x0_noise):
            x0 = x0 + self._drawn(term, f"x0/{number}" if number else "x0", runs, 1)[:, 0]
        return x0

    def _sum(
        self, terms: tuple[Noise, ...], name: str, runs: range, n_samples: int, n: int
    ) -> Float[Array, "runs samples n"]:
        total = np.zeros((len(runs), n_samples, n))
        for number, term in enumerate(terms):
            if not term.alters_output:
                total += self._drawn(term, f"{name}/{number}", runs, n_samples)
        return total

    def _drawn(self, law: Noise, name: str, runs: range, n_samples: int) -> Float[Array, "runs samples n"]:
        """Draw one law for many runs: `Noise.draw` with the stream of every run."""
        rngs = generators(self.seed, runs, name)
        if type(law) is not Gaussian:
            # A law of a user may return the same array for every run.
            return np.array([np.array(law.draw(rng, n_samples)) for rng in rngs])
        z = np.empty((len(runs), n_samples, len(law.mean)))
        for of_run, rng in zip(z, rngs, strict=True):
            rng.standard_normal(out=of_run)
        return np.add(law.mean, law.shaped(z.reshape(len(runs) * n_samples, -1)).reshape(z.shape), out=z)

    def _alterations(
        self, channel: str, terms: tuple[Noise, ...], runs: range, n_samples: int
    ) -> tuple[Alteration, ...]:
        # Laws of the input act in their order, those that add, too.
        laws = [(f"{channel}/{i}", law) for i, law in enumerate(terms) if law.alters_output or channel == "u"]
        return tuple(Alteration(law, self._drawn(law, name, runs, n_samples)) for name, law in laws)

    def _in_burst(self, runs: range, n_samples: int) -> Bool[Array, "runs samples"] | None:
        laws = [(f"v/{number}", law) for number, law in enumerate(self.measurement) if law.has_bursts]
        if not laws:
            return None
        inside = np.zeros((len(runs), n_samples), dtype=bool)
        for name, law in laws:
            for row, rng in enumerate(generators(self.seed, runs, name)):
                inside[row] |= law.in_burst(rng, n_samples)
        return inside

    def _random_bursts(self) -> list[tuple[str, str, Noise]]:
        """Prefix of the names, stream and law, for every law whose bursts are drawn."""
        found = [
            (f"{channel}/{number}", law)
            for channel, laws in (("w", self.process), ("v", self.measurement), ("u", self.input))
            for number, law in enumerate(laws)
            if law.burst_names
        ]
        return [(f"{name.replace('/', '')}_" if len(found) > 1 else "", name, law) for name, law in found]


def _moments(terms: tuple[Noise, ...], n: int) -> tuple[Array, Array] | None:
    """Mean and covariance of a sample of a sum of independent laws; None where those of one are not known."""
    mean, cov = np.zeros(n), np.zeros((n, n))
    for term in terms:
        if term.mean is None or term.cov is None or term.alters_output:
            return None
        mean, cov = mean + term.mean, cov + term.cov
    return mean, cov


def with_cross_covariance(scenario: Scenario, S: Float[Array, "rows columns"], nw: int, nv: int) -> Scenario:
    """Give w and v a cross-covariance: v = T (w - w_bar) + what of v is left, which is independent of w.

    The noises of the scenario are independent, S = E (w - w_bar)(v - v_bar)'.  A DesignError says that its shape is not
    (nw, nv), a noise is not one gaussian law, or no noises have these covariances.
    """
    laws = (*scenario.process, *scenario.measurement)
    if S.shape != (nw, nv):
        raise DesignError(does_not_fit(S.shape, (nw, nv)))
    if (
        len(scenario.process) != 1
        or len(scenario.measurement) != 1
        or not all(isinstance(law, Gaussian) for law in laws)
    ):
        raise DesignError("a cross-covariance needs one gaussian law for the process and one for the measurement noise")
    w, v = (law for law in laws if isinstance(law, Gaussian))
    std_w, std_v = np.sqrt(np.diag(w.cov)), np.sqrt(np.diag(v.cov))
    units = np.outer(std_w, std_v)
    # Correlations instead of covariances, so that what is small in its unit does not count for a rounding.
    scale_w, scale_v = np.where(std_w > 0.0, std_w, 1.0), np.where(std_v > 0.0, std_v, 1.0)
    shared, W = S / np.outer(scale_w, scale_v), w.cov / np.outer(scale_w, scale_w)
    T = shared.T @ np.linalg.pinv(W, hermitian=True)
    left = v.cov / np.outer(scale_v, scale_v) - T @ shared
    fits = np.allclose(T @ W, shared.T, rtol=1e-9, atol=1e-12) and np.linalg.eigvalsh(left)[0] > -1e-12  # rounding
    if S[units == 0.0].any() or not fits:
        raise DesignError("the joint covariance of the noises with this cross-covariance is not positive semidefinite")
    rest = Gaussian(v.mean, scale_v[:, None] * psd_sqrt(left))
    return replace(scenario, measurement=(rest,), cross=scale_v[:, None] * T / scale_w)


class Recording(NamedTuple):
    """The trajectories to keep."""

    signals: tuple[str, ...] = ()  # of `Record`: ``y``, ``u``, ``x``, ``x_hat``
    n_runs: int = 0  # of how many runs, from the first one on
    ensemble: bool = False  # whether to keep mean and covariance of (x, x_hat) over the runs, at every k


@dataclass(frozen=True, eq=False)
class Experiment:
    """Everything a worker needs: picklable, made once.

    Parameters
    ----------
    plant : the true system
    methods : the pairs to compare
    scenario : random inputs and reference of every run
    metrics : the numbers to keep of every run
    n_runs, n_steps : size of the experiment; samples are k = 0..n_steps
    recording : the trajectories to keep
    tick : length of one sample in the unit in which windows of metrics are given: Ts with seconds, 1 with samples
    cut_windows : whether windows of metrics that reach beyond the last sample end there
    state_range : limits of the state beyond which a run has failed
    time_unit : unit of the time in texts
    angles : place of a component that is an angle, such as x.0 or y.0 -> its period

    Examples
    --------
    >>> import rmpc_bench
    >>> given = rmpc_bench.load_config("quickstart", runs=4).experiment
    >>> given.n_runs, given.n_steps, given.method("R-MPC").estimator.form
    (4, 200, 'filter')
    """

    plant: Plant
    methods: tuple[Method, ...]
    scenario: Scenario
    metrics: tuple[Metric, ...]
    n_runs: int
    n_steps: int
    recording: Recording = Recording()
    tick: float = 1.0
    cut_windows: bool = False
    state_range: StateRange = StateRange()
    time_unit: str = "s"
    angles: Mapping[str, float] = field(default_factory=dict)

    @property
    def metric_layout(self) -> MetricLayout:
        """What metrics need to know of the experiment."""
        units = self.plant.y_unit, self.plant.u_unit
        return MetricLayout(
            self.n_steps,
            self.tick,
            *units,
            self.cut_windows,
            self.plant,
            self.methods,
            time_unit=self.time_unit,
            angles=self.angles,
        )

    @property
    def metric_infos(self) -> tuple[MetricInfo, ...]:
        """Columns of the metrics."""
        return tuple(metric.info(self.metric_layout) for metric in self.metrics)

    @cached_property
    def oracles(self) -> frozenset[str]:
        """Names of the methods with an oracle estimator."""
        return frozenset(method.name for method in self.methods if method.estimator.knows_uncertainty)

    def method(self, name: str) -> Method:
        """Look a method up by its name."""
        return self._by_name[name]

    @cached_property
    def _by_name(self) -> dict[str, Method]:
        return {method.name: method for method in self.methods}


class Alteration(NamedTuple):
    """A law that alters a signal, or adds to the input, with its random numbers."""

    law: Noise
    drawn: Float[Array, "runs samples n"]


class Draws(NamedTuple):
    """Everything that is random or given from outside, for a block of runs."""

    delta: Any
    x0: Float[Array, "runs nx"]
    w: Float[Array, "runs samples nw"]
    v: Float[Array, "runs samples nv"]
    bursts: Bool[Array, "runs samples"] | None = None  # whether a term of v is in a burst; None where none has bursts
    alterations: tuple[Alteration, ...] = ()  # what alters the measurements after v was added, in order
    inputs: tuple[Alteration, ...] = ()  # the laws of the input, in order

    @property
    def omits_measurements(self) -> bool:
        """Whether a measurement may be missing."""
        return any(law.omits_measurements for law, _ in self.alterations)

    def altered(self, k: int, y: Float[Array, "runs ny"]) -> Float[Array, "runs ny"]:
        """Return what is measured at k, as the laws that alter measurements leave it."""
        for law, drawn in self.alterations:
            y = np.array(law.altered(y, drawn[:, k]))
        return y


_CONSTANTS = (str, bytes, bool, int, float, complex, np.generic, type(None))


def own_draws(scenario: Scenario, plant: Plant, runs: range, n_steps: int, draws: Draws) -> Draws:
    """Return a copy of random inputs that a method may write into; ``draws`` stays as it is.

    A record of the plant that consists of anything but arrays and numbers is drawn again.  What alters the measurements
    is not handed to any component, and is not copied.
    """
    try:
        delta = _copied(draws.delta)
    except TypeError:
        delta = scenario.draw_delta(plant, runs, n_steps)
    return draws._replace(delta=delta, x0=draws.x0.copy(), w=draws.w.copy(), v=draws.v.copy())


def _copied(value: Any) -> Any:
    """Copy the arrays in tuples, lists and mappings; raise a TypeError if there is anything else."""
    if type(value) is np.ndarray and value.dtype != object:
        # Nothing can be written into a read-only array, such as one broadcast to all runs.
        return value.copy() if value.flags.writeable else value
    if isinstance(value, _CONSTANTS):
        return value
    if isinstance(value, tuple):
        parts = [_copied(each) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if type(value) is list:
        return [_copied(each) for each in value]
    if type(value) is dict:
        return {name: _copied(each) for name, each in value.items()}
    raise TypeError(f"cannot copy a {type(value).__name__}")


def random_besides(experiment: Experiment) -> tuple[str, ...]:
    """Name what differs from run to run and is not stored as an uncertain quantity."""
    scenario, plant = experiment.scenario, experiment.plant
    designs = (plant, *(design for method in experiment.methods for design in (method.estimator, method.controller)))
    found = {
        "noise": any(_is_random(term) for term in (*scenario.process, *scenario.measurement, *scenario.input)),
        "initial state": any(_is_random(term) for term in scenario.x0_noise),
        "matrices of the plant": plant.draws_steps,
        "random numbers of a component": not all(design.deterministic for design in designs),
    }
    return tuple(name for name, is_random in found.items() if is_random)


def stores_quantities(experiment: Experiment) -> bool:
    """Whether values of uncertain quantities are stored of every run: named ones, bursts, or matrices of the plant."""
    scenario, plant = experiment.scenario, experiment.plant
    of_plant = plant.system is not None and not plant.draws_steps
    return bool(scenario.uncertainty or scenario.burst_names or of_plant)


def _is_random(term: Noise) -> bool:
    """Whether a law has a spread; one that does not know its covariance has some."""
    return term.cov is None or bool(np.any(term.cov))
