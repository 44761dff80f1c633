"""report.html and report.md: one page per experiment, and an index of several."""
