"""Fixtures of this folder."""

from page_sources import html as html
from page_sources import make_source as make_source
from page_sources import markdown as markdown
