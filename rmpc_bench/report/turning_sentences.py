"""Where the ranking of methods turns along a swept number, in sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rmpc_bench.analysis.comparison import levels
from rmpc_bench.analysis.comparison_text import size_text
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.rounding import significant_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.turning_points import Track, failed_shares, numeric_paths, tracks
from rmpc_bench.types import MetricInfo


def turning_sentences(trials: Trials) -> Iterator[str]:
    """Say for every swept number and method where the sign of the change from the baseline turns.

    A table without sweep, and a population of single runs, have no sentences.
    """
    info = trials.points[0].primary_info if trials.points else None
    if info is None or not trials.with_verdicts or trials.is_population:
        return
    paths = numeric_paths(trials)
    of = levels(trials) if paths else None
    for path in paths:
        found = list(tracks(trials, path, info, of))
        yield from (_turning(track, info, trials) for track in found)
        yield from _failing(found, trials)


def _turning(track: Track, info: MetricInfo, trials: Trials) -> str:
    at = f" at {track.others}" if track.others else ""
    what = f"the change of {name_of_distance(info)} of {track.method} against {trials.baseline}"
    first, last = _place(track, 0), _place(track, -1)
    if track.turns:
        texts = [
            f"between {_place(track, a)} ({_size(track, a, info)}) and {_place(track, b)} ({_size(track, b, info)})"
            for a, b in track.turns
        ]
        return f"Along {track.path}{at}, {what} changes its sign {' and '.join(texts)}."
    known = [n for n, change in enumerate(track.changes) if not math.isnan(change)]
    signed = [n for n in known if track.signs[n]]
    if not known:
        return f"Along {track.path}{at}, {what} has no value at any point from {first} to {last}."
    ends = ", ".join(f"{_size(track, n, info)} at {_place(track, n)}" for n in dict.fromkeys((known[0], known[-1])))
    every = f"all {len(known)} points" if len(known) > 1 else "the only point"
    if not signed:
        return f"Along {track.path}{at}, {what} has an interval that contains 0 at {every}: {ends}."
    word = "negative" if track.signs[signed[0]] < 0 else "positive"
    if len(signed) == len(known):
        return f"Along {track.path}{at}, {what} is {word} at {every} with a value: {ends}."
    rest = ", ".join(_place(track, n) for n in known if n not in signed)
    where = f"{word} at {len(signed)} of {len(known)} points, and its interval contains 0 at {rest}"
    return f"Along {track.path}{at}, {what} is {where}: {ends}."


def _size(track: Track, n: int, info: MetricInfo) -> str:
    return size_text(track.rows[n], info)


def _place(track: Track, n: int) -> str:
    return significant_text(track.places[n], 6)


def _failing(found: list[Track], trials: Trials) -> Iterator[str]:
    """Give the failed runs along the path, for every method that has some."""
    for others in dict.fromkeys(track.others for track in found):
        track = next(track for track in found if track.others == others)
        at = f" at {others}" if others else ""
        for method in trials.methods:
            counts = failed_shares(track.points, method)
            if any(failed for failed, _ in counts):
                texts = [f"{failed} of {n} at {_place(track, place)}" for place, (failed, n) in enumerate(counts)]
                yield f"Along {track.path}{at}, {method} fails in {', '.join(texts)}."
