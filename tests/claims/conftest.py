"""Fixtures of this folder."""

from claim_tables import make_trials as make_trials
