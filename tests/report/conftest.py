"""Fixtures of this folder."""

from figure_tables import make_sweep as make_sweep
from figure_tables import make_trials as make_trials
from figure_tables import record as record
from figure_tables import with_series as with_series
from page_sources import html as html
from page_sources import make_source as make_source
from page_sources import markdown as markdown
