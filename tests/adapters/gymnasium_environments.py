"""Small environments with the habits that the adapter of Gymnasium must know."""

import random

import numpy as np
import pytest

pytest.importorskip("gymnasium")

import gymnasium
from gymnasium.spaces import Box, Dict


class Lag(gymnasium.Env):
    """First-order lag with a gain and a factor that is computed from it once."""

    observation_space = Box(-np.inf, np.inf, (1,), np.float32)
    action_space = Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, pole=0.9, width=1.0):
        self.pole, self.width = pole, width
        self.gain = 1.0
        self.square = self.gain**2
        self.unused = 3.0

    def reset(self, *, seed=None, options=None):
        """Start at a random state."""
        super().reset(seed=seed)
        self.x = self.np_random.uniform(-self.width, self.width, 1)
        return self.x.astype(np.float32), {}

    def noise(self, u):
        """Add nothing."""
        return 0.0

    def step(self, u):
        """Move; a state beyond 5 ends the episode."""
        self.x = self.pole * self.x + self.square * u + self.noise(u)
        return self.x.astype(np.float32), 0.0, bool(abs(self.x[0]) > 5.0), False, {}


class Noisy(Lag):
    """Draws one number at every step."""

    def noise(self, u):
        """Draw a number."""
        return 0.1 * self.np_random.standard_normal()


class NoisyByAction(Lag):
    """Draws a number where the action is positive."""

    def noise(self, u):
        """Draw a number, or none."""
        return 0.1 * self.np_random.standard_normal() if u[0] > 0 else 0.0


class Unseeded(Lag):
    """Uses the global generator of Python."""

    def noise(self, u):
        """Draw a number that no seed of the bench determines."""
        return 0.1 * random.random()


class Worn(Lag):
    """Counts the steps of all its objects in an attribute of the class, which has an effect."""

    n_steps = 0

    def noise(self, u):
        """Return a slow growth."""
        type(self).n_steps += 1
        return 1e-3 * self.n_steps


class Single(Lag):
    """Refuses actions that are not in its space, as float64 is not."""

    def step(self, u):
        """Check the action."""
        assert self.action_space.contains(u), f"{u!r} is not in the space"
        return super().step(u)


class Mapped(Lag):
    """Has an observation of several parts."""

    observation_space = Dict({"a": Box(-1, 1, (1,)), "b": Box(-1, 1, (1,))})

    def reset(self, *, seed=None, options=None):
        """Return a mapping."""
        return {"a": np.zeros(1), "b": np.zeros(1)}, super().reset(seed=seed)[1]


class Doubled(gymnasium.ActionWrapper, gymnasium.utils.RecordConstructorArgs):
    """Doubles the action, as a part of a registration."""

    def __init__(self, env):
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)

    def action(self, u):
        """Double it."""
        return 2.0 * u


def set_gain(env, p):
    """Set the gain with what depends on it."""
    env.gain, env.square = p.gain, p.gain**2


def get_x(env):
    """Return the state."""
    return env.x


def set_x(env, x):
    """Set the state."""
    env.x = x
