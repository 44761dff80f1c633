"""Figures of stored results: one file per kind, each one frozen dataclass whose fields are its YAML keys.

The kinds are boxplot, elements, ellipses, rows, scatter, signals, sweep and tuning.  A kind checks its requirements
on the layout of the results in `check` and draws them in `draw`.
Only `draw` imports matplotlib, so that ``rmpc-bench check`` stays fast.

Numbers     nees_lines, pareto_front, reported_sets, recorded_runs, samples, ellipse_outline, window
Over time   quantities (what can be shown), curves (its numbers), signal_panels, thinning, burst_bands
Scatter     scatter (metrics), scatter_paths (signals)
Drawing     axes, legend, labels, direct_labels, sweep_points
Rows        boxes, row_columns; point_tables (the rows of a metric at every point)
Sweeps      sweep_axis, sweep_content, line_panels, cell_panels
Style       palette (colours on both grounds), style (fonts), line_styles (colour and dashes of a method)
Files       rendering (width, font, style, formats), files (how each format is written), svg_text, stable_svg
Others      component_plot (plots of a component itself), figure_result (what `figure` returns),
            shared_content (what picture and caption share)
"""
