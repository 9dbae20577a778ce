"""Figures 4.6 to 4.11: features of a KLT tracker on three scenes of the workcell."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..offline import thesis
from ..tables import spread
from . import panels
from .footage import PICTURE, SECONDS, Shot, Stills, film_setup, filmed_messages
from .numbers import best, right_rows, row_of, rows_of_each, run_parameters
from .runs import SceneRuns, View, ViewRequest
from .study import DEFAULT, Drawn, Row, Simulated, Study

PERIOD = 1 / 3
SWITCHES = (0.0025, 0.005, 0.01, 0.02, 0.04)
_START_S = 4.0
_SHADE = 8
# When the shelf's door turns (see its scene).
_OPENING_S, _CLOSING_S = (3.0, 5.0), (6.4, 8.8)


TRUCK = Shot("truck", 15, (4.0, 6.0, 8.0, 14.0), ("truck", "gripper"), "different, if observed for long")
TOWER = Shot("truck-tower", 30, (4.0, 6.0, 8.0, 14.0), ("truck", "tower"), "nicely separated")
SHELF = Shot("shelf", 15, (10 / 3, 16 / 3, 22 / 3, 37 / 3), ("door", "drawer"), "a hypothesis each")


def _takes(study: Study, shot: Shot) -> dict[str, SceneRuns]:
    configs = {f"σ = {s:g} m": thesis(s) for s in SWITCHES}
    how = Simulated(shot.scene, configs, PERIOD, ViewRequest(shot.times, trail=0.7))
    return study.takes(how, partial(filmed_messages, study, shot), study.options.workcell_seeds)


def pictures(shot: Shot) -> Callable[[Study], Drawn]:
    """Figures 4.6 to 4.8: moments of a scene, features coloured by hypothesis."""

    def draw(study: Study) -> Drawn:
        takes = _takes(study, shot)
        label = best(takes)
        shown = {f"thesis method, {label}": takes[label], DEFAULT: takes[DEFAULT]}
        stills = Stills(shot.scene, study.options.workcell_seeds[0])
        figure = panels.new_figure(3.25 * len(shot.times), 7.9)
        rows = figure.subplots(3, len(shot.times))
        for row, (label, take) in zip(rows, shown.items(), strict=False):
            styles = panels.Styles(take.seeds[0].names, take.seeds[0].votes())
            for axes, view in zip(row, take.seeds[0].views, strict=True):
                _picture(axes, stills, view, styles)
            row[0].set_ylabel(label, fontsize=11, fontweight="bold")
        _truth(rows[2], stills, shown[DEFAULT])
        panels.object_legend(figure, stills.names)
        return Drawn(figure, _moment_rows(shown, shot), _parameters(study, shot, drawn=True))

    return draw


def curves(shot: Shot) -> Callable[[Study], Drawn]:
    """Figures 4.9 to 4.11: NMI over time for several σ and the default method."""

    def draw(study: Study) -> Drawn:
        takes = _takes(study, shot)
        seeds = study.options.workcell_seeds
        figure = panels.switch_curves(takes, seeds, 4.8, duration=SECONDS, columns=2)
        made_with = _parameters(study, shot, drawn=False)
        return Drawn(figure, rows_of_each("mean NMI", takes, "-" * len(SWITCHES)), made_with, takes)

    return draw


def _picture(axes: Any, stills: Stills, view: View, styles: panels.Styles) -> None:
    # Paler than it was, so that the features stand out; in fewer shades, so that the file is small.
    image = stills.picture(view.t).astype(np.float32)
    pale = 0.45 * image + 0.2 * image.mean(axis=2, keepdims=True) + 0.35 * 255
    shades = (pale / _SHADE).round() * _SHADE
    extent = (-0.5, PICTURE[0] - 0.5, PICTURE[1] - 0.5, -0.5)
    axes.imshow(shades.clip(0, 255).astype(np.uint8), extent=extent, interpolation="nearest")
    flat = replace(
        view,
        moment=replace(view.moment, positions=stills.pixels(view.moment.positions)),
        trails=[stills.pixels(trail) for trail in view.trails],
    )
    panels.draw_tracks(axes, flat, styles, size=4.0, edge=0.5)
    axes.set(xlim=extent[:2], ylim=extent[2:], xticks=[], yticks=[])
    axes.set_title(f"t = {view.t:.3g} s", fontsize=10)


def _truth(row: Any, stills: Stills, take: SceneRuns) -> None:
    """Draw the true objects of the same features; those that are not scored are undetermined here."""
    first = take.seeds[0]
    styles = panels.Styles(first.names, {(number, number): 1 for number in first.names})
    for axes, view in zip(row, first.views, strict=True):
        scored = view.moment.objects >= 0
        moment = view.moment.of(scored)
        moment = replace(moment, hypotheses=moment.objects)
        trails = [trail for trail, shown in zip(view.trails, scored, strict=True) if shown]
        _picture(axes, stills, replace(view, moment=moment, trails=trails), styles)
    row[0].set_ylabel("truth", fontsize=11, fontweight="bold")


def _moment_rows(takes: dict[str, SceneRuns], shot: Shot) -> list[Row]:
    rows = right_rows(takes, shot.times, "-")
    name, other = shot.apart
    what = f"{name} and {other} in different hypotheses, from t = {_START_S:g} s on"
    rows.append(row_of(what, shot.said, takes, lambda take: _apart(take, name, other)))
    if shot is SHELF:
        rows.append(row_of("the door's hypothesis, closing", "another than opening", takes, _door))
    return rows


def _apart(take: SceneRuns, name: str, other: str) -> str:
    """Share of updates in which most of two objects' features are in different hypotheses."""
    shares = []
    for seed in take.seeds:
        first, second = seed.main_of(name), seed.main_of(other)
        known = (seed.t >= _START_S) & (first >= 0) & (second >= 0)
        shares.append(100 * np.mean(first[known] != second[known]) if known.any() else np.nan)
    return f"{spread(shares, 0)} % of updates"


def _door(take: SceneRuns) -> str:
    """Whether the door has the same hypothesis while it closes as while it opened."""
    same = 0
    for seed in take.seeds:
        ids = seed.main_of("door")
        opening, closing = (_most(ids[(seed.t >= a) & (seed.t < b)]) for a, b in (_OPENING_S, _CLOSING_S))
        same += opening == closing
    return f"the same in {same} of {len(take.seeds)} seeds"


def _most(ids: Any) -> int:
    known = ids[ids >= 0]
    return int(np.bincount(known).argmax()) if len(known) else -1


def _parameters(study: Study, shot: Shot, *, drawn: bool) -> dict[str, str]:
    camera, tracker = film_setup(study, shot)
    made_with = {
        "scene": f"workcell:{shot.scene}, camera a, {camera.size[0]}x{camera.size[1]} at {camera.rate:g} Hz",
        "tracker": f"new features every {tracker.respawn_every} frames at the {tracker.spawn_limit} "
        f"best corners, at most {tracker.max_features} at once",
    }
    switches = f"σ = {', '.join(f'{s:g}' for s in SWITCHES)} m, equal weights"
    return made_with | run_parameters(switches, PERIOD, study.options.workcell_seeds, drawn=drawn)
