"""Recorded data of a run: its signals, the signals that its method reports, and the bursts of the noise."""

from __future__ import annotations

from rmpc_bench.simulation.closed_loop import BURSTS, COVARIANCE, SIGNALS
from rmpc_bench.simulation.scenario import Experiment, Recording, Scenario


def has_bursts(scenario: Scenario) -> bool:
    """Whether a law of the measurement noise has bursts."""
    return any(law.has_bursts for law in scenario.measurement)


def with_bursts(recording: Recording, *, bursts: bool) -> Recording:
    """Record bursts where there are some and anything is recorded; nowhere else.

    Parameters
    ----------
    recording : what is asked for
    bursts : whether a law of the measurement noise has some
    """
    signals = tuple(name for name in recording.signals if name != BURSTS)
    return recording._replace(signals=(*signals, BURSTS) if bursts and recording.n_runs else signals)


def kept(experiment: Experiment, name: str) -> Recording:
    """What is kept of the runs of one method: a signal that it does not report leaves no trace.

    Parameters
    ----------
    experiment : what it runs in
    name : of the method
    """
    recording = experiment.recording
    there = {*SIGNALS, BURSTS, COVARIANCE, *experiment.plant.extra_signals, *experiment.method(name).reports}
    return recording._replace(signals=tuple(signal for signal in recording.signals if signal in there))
