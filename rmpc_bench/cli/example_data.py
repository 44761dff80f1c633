"""Recorded runs of a cart, for a new experiment with recorded data."""

from __future__ import annotations

N_RUNS, N_SAMPLES = 8, 101


def recorded_runs(name: str) -> dict[str, str]:
    """Return the files of the runs and their texts.

    Parameters
    ----------
    name : of the experiment
    """
    return {f"{name}_data/run-{run}.csv": _run(run) for run in range(N_RUNS)}


def _run(run: int) -> str:
    # Slow to import, and only needed here.
    import numpy as np

    rng = np.random.Generator(np.random.PCG64(run))
    lines, position, speed = ["time,force,position,true_position,true_speed"], 0.0, 0.0
    for k in range(N_SAMPLES):
        force = 1.0 if (k // 25 + run) % 2 else -1.0
        measured = position + 0.02 * rng.standard_normal()
        lines.append(f"{0.1 * k:.1f},{force:g},{measured:.6f},{position:.6f},{speed:.6f}")
        position += 0.1 * speed + 1e-3 * rng.standard_normal()
        speed += -0.05 * speed + 0.1 * force + 1e-2 * rng.standard_normal()
    return "\n".join(lines) + "\n"
