"""Fixtures of this folder."""

from figure_tables import make_sweep as make_sweep
from figure_tables import make_trials as make_trials
from figure_tables import with_series as with_series
