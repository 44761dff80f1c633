"""The panels of a figure of trajectories, with an enlarged one below, and what their lines mean in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from rmpc_bench.figures import burst_bands
from rmpc_bench.figures.axes import stacked_panels
from rmpc_bench.figures.captions import joined, label_of, place, sentences, span_of
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import legend_sample, line_styles
from rmpc_bench.figures.recorded_runs import OUTPUT, PanelSignal, RunSelection
from rmpc_bench.figures.run_curves import CurveOptions, draw_curves, draw_reference, explanation, is_rough, mean_widths
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.figures.window import TimeWindow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials


class Content(NamedTuple):
    """What a figure of trajectories shows."""

    point: Trials
    title: str
    panels: Sequence[PanelSignal]
    window: TimeWindow
    runs: dict[str, RunSelection]
    zoom: tuple[PanelSignal, TimeWindow] | None
    """The signal and the samples of the enlarged panel."""
    options: CurveOptions
    difference: bool
    """Whether the signals are differences to the baseline."""


def draw_panels(made: Content, size: tuple[float, float]) -> MplFigure:
    """Draw the panels of a figure of trajectories in a picture of some width and height [in]."""
    from matplotlib.figure import Figure as MplFigure

    point, window, runs = made.point, made.window, made.runs
    styles = line_styles(point.all_methods, list(runs))
    options = made.options
    views = [(panel, window) for panel in made.panels] + ([made.zoom] if made.zoom else [])
    rough = [is_rough(point, panel, shown, runs) for panel, shown in views]
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        panels = _panels(figure, len(made.panels), len(views))
        handles: list[Handle] = []
        for name in runs:
            failed = " (failed)" if runs[name].failed else ""
            handles.append((label_of(point, name) + failed, legend_sample(styles[name], rough=all(rough))))
        reference: Handle | None = None
        for number, (axes, (panel, shown), solid) in enumerate(zip(panels, views, rough, strict=True)):
            if made.difference:
                axes.axhline(0.0, color=REFERENCE, lw=0.9, zorder=2.0)
            elif panel.signal == OUTPUT and not made.options.width:
                reference = "reference", draw_reference(axes, point.traces[next(iter(runs))], panel, shown)
            how = options._replace(enlarged=number == len(made.panels))
            draw_curves(axes, point, panel, shown, runs, styles, how, rough=solid)
            axes.set_ylabel(_label(panel.label, made))
            rows = {name: each.rows for name, each in runs.items()}
            bursts = burst_bands.shade([axes], burst_bands.spans(burst_bands.bursts_of(point, rows), shown))
            axes.set_xlim(*shown.limits)
        if made.zoom is not None:
            _mark(panels, made)
        for axes in {panels[len(made.panels) - 1], panels[-1]}:
            axes.set_xlabel(window.label)
        handles += [each for each in (reference, *bursts) if each is not None]
        note = explanation(point, runs, options)
        base = f"difference to {label_of(point, point.baseline)}" if made.difference else ""
        finish(figure, handles, "\n".join(filter(None, [made.title, ", ".join(filter(None, [base, note]))])))
    return figure


def _panels(figure: MplFigure, n: int, n_all: int) -> list[Axes]:
    """Stack panels on a common horizontal axis, and the enlarged one on an axis of its own."""
    panels = stacked_panels(figure, n_all, sharex=n == n_all)
    if n < n_all:
        for axes in panels[1:n]:
            axes.sharex(panels[0])
        for axes in panels[: n - 1]:
            axes.tick_params(labelbottom=False)
    return panels


def _label(label: str, made: Content) -> str:
    if made.options.width:
        return f"width of {label}"
    return f"\N{GREEK CAPITAL LETTER DELTA}{label}" if made.difference else label


def _mark(panels: Sequence[Axes], made: Content) -> None:
    """Mark the enlarged part in the panel of its signal, and name it in the panel that shows it."""
    assert made.zoom is not None
    panel, shown = made.zoom
    for axes, each in zip(panels, made.panels, strict=False):
        if (each.signal, each.component) == (panel.signal, panel.component):
            axes.axvspan(*shown.limits, facecolor="none", edgecolor=REFERENCE, lw=0.8, ls=(0, (2, 1)), zorder=2.2)
    run = first_runs(made)
    panels[-1].set_title(f"enlarged{f', {run}' if run else ''}", loc="left", pad=2.0)


def caption_of(made: Content) -> str:
    """Define lines and bands, count the runs and name the enlarged part."""
    what = joined(dict.fromkeys(each.label for each in made.panels))
    if made.difference:
        what = f"difference of {what} from {label_of(made.point, made.point.baseline)} in paired runs,"
    elif made.options.width:
        what = f"width of the bands of {what}"
    with_reference = any(each.signal == OUTPUT for each in made.panels)
    return sentences(
        f"Recorded runs: {what} over time for {joined(label_of(made.point, name) for name in made.runs)}, "
        f"{span_of(made.window)}",
        place(made.point, made.title),
        _meaning(made),
        "The grey dashed line is the reference"
        if with_reference and not (made.difference or made.options.width)
        else "",
        _zoomed(made),
    )


def _zoomed(made: Content) -> str:
    """Say what the enlarged panel shows; empty without one."""
    if made.zoom is None:
        return ""
    run = first_runs(made)
    lines = f", with the bands and as lines {run} of every method" if run else ""
    return f"The last panel enlarges {made.zoom[0].label}, {span_of(made.zoom[1])}{lines}"


def first_runs(made: Content) -> str:
    """Name the run that the enlarged panel shows; empty where no method has several runs."""
    if all(len(each.rows) == 1 for each in made.runs.values()):
        return ""
    numbers = {int(made.point.traces[name].runs[each.rows[0]]) for name, each in made.runs.items()}
    return f"run {numbers.pop()}" if len(numbers) == 1 else "the first run that finished"


def _meaning(made: Content) -> str:
    """Explain lines and bands of a caption, with the mean widths of the bands if these are shown."""
    counts = sorted({len(each.rows) for each in made.runs.values()})
    failed = [f"{label_of(made.point, name)} {each.n_failed}" for name, each in made.runs.items() if each.n_failed]
    note = f" Failed runs are left out where others finished ({', '.join(failed)})." if failed else ""
    if counts[-1] == 1:
        runs = {int(made.point.traces[name].runs[each.rows[0]]) for name, each in made.runs.items() if len(each.rows)}
        return f"One run of every method is shown (run {', '.join(map(str, sorted(runs)))}).{note}"
    n = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    if made.options.width:
        text = f"A line is the distance between the 5 and the 95 % quantile of {n} runs"
        return f"{text}; its mean over the samples is, for {_widths(made)}.{note}"
    single = f" Thin lines are the first {made.options.n_single} of them." if made.options.n_single > 1 else ""
    single = " The thin line is one of them." if made.options.n_single == 1 else single
    return f"Thick lines are medians of {n} runs, areas reach from their 5 to their 95 % quantile.{single}{note}"


def _widths(made: Content) -> str:
    texts = []
    for panel in made.panels:
        found = mean_widths(made.point, panel, made.window, made.runs)
        each = (f"{label_of(made.point, name)} {width:.3g}" for name, width in found.items())
        texts.append(f"{panel.label}: {', '.join(each)}")
    return "; for ".join(texts)
