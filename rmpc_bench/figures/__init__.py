"""Figures of stored results: one file per kind, each one frozen dataclass whose fields are its YAML keys.

The kinds are boxplot, coverage, elements, ellipses, rows, scatter, signals, sweep and tuning.  A kind checks its
requirements on the layout of the results in `check` and draws them in `draw`.
Only `draw` imports matplotlib, so that ``rmpc-bench check`` stays fast.

What is shown  points (of a sweep), recorded_runs (and series), quantities, curves and signal_content (over time),
               scatter_paths, sweep_content
Drawing        row_columns, sweep_panels; axes, labels, legend
Style          palette (colours on both grounds, look of a method), style (fonts and settings)
Files          files (how each format is written), svg_text
Others         component_plot (plots of a component itself)
"""
