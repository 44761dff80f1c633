"""Figures of stored results: one file per kind, each one frozen dataclass whose fields are its YAML keys.

The kinds are boxplot, elements, ellipses, estimation_error, means, nees, pareto, plane, rows, series, sweep,
trajectories, tubes and variance_with_bound.  A kind checks its requirements on the layout of the
results in `check` and draws them in `draw`.
Only `draw` imports matplotlib, so that ``rmpc-bench check`` stays fast.

Numbers     nees_lines, pareto_front, reported_sets, recorded_runs, samples, ellipse_outline, window
Drawing     error_panels, axes, legend, labels, direct_labels, burst_bands, ensemble_panels, sweep_points
Sweeps      sweep_axis, sweep_content, line_panels, cell_panels; point_tables
Style       style (palette, fonts), line_styles (colour and dashes of a method)
Files       rendering (width, font, style, formats), files (how each format is written)
Others      component_plot (plots of a component itself), figure_result (what `figure` returns),
            shared_content (what picture and caption share)
"""
