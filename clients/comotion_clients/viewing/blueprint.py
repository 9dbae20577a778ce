"""Arranges the viewer: a Rerun blueprint of views of spaces and cameras, curves, a page and a log."""

from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from .drawing import TRAIL_S, Layout, SpaceView
from .health import LEGEND_COLUMNS, LEGEND_HEIGHT, LEGEND_LIFT, LEGEND_ROWS, LEGEND_WIDTH
from .paths import plain

TIMELINE = "stamp"
CURVES_S = 60.0
"""Time span of the curves."""
_AXES = {"z-up": rr.ViewCoordinates.RIGHT_HAND_Z_UP, "optical": rr.ViewCoordinates.RDF}
_GROUND = (52, 52, 58)  # the dark and the light shades of hypotheses are visible on it
_LINES = rrb.LineGrid3D(visible=True, color=(90, 90, 96))


def prepare(recording: Any, layout: Layout) -> None:
    """Log the orientation of the spaces."""
    for space in layout.spaces:
        if space.axes in _AXES:
            recording.log(space.path, _AXES[space.axes], static=True)
        elif space.axes == "y-up":
            # The y axis of Rerun's 2-D views points down.
            recording.log(space.path, rr.Transform3D(scale=(1.0, -1.0, 1.0)), static=True)


def blueprint(layout: Layout) -> Any:
    """Build the blueprint of a layout."""
    words = rrb.Horizontal(
        rrb.TextLogView(
            origin="log",
            name="Events",
            # The sink writes the time into the text, because the time column is too narrow to read.
            columns=rrb.TextLogColumns(
                timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=False)],
                text_log_columns=["loglevel", "body"],
            ),
        ),
        rrb.TextDocumentView(origin="summary", name="Scene"),
        column_shares=[1, 1],
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(_scene(layout), words, row_shares=[7, 3]),
            _side(layout),
            column_shares=[7, 3],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _scene(layout: Layout) -> Any:
    """Arrange the spaces on the left and the cameras on the right."""
    spaces = [_space(space) for space in layout.spaces]
    cameras = [_space(camera, camera.path) for camera in layout.cameras]
    if not spaces and not cameras:
        return rrb.TextDocumentView(origin="summary", name="Scene")
    if not spaces or not cameras:
        return rrb.Grid(*spaces, *cameras)
    return rrb.Horizontal(rrb.Grid(*spaces), rrb.Vertical(*cameras), column_shares=[3, 2])


def _last(seconds: float) -> Any:
    return rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )


def _space(space: SpaceView, origin: str = "spaces") -> Any:
    options: dict[str, Any] = {
        "contents": f"/{space.path}/**",
        "name": plain(space.name),
        "background": _GROUND,
        # Segments of the last seconds; all other shapes are the newest ones.
        "overrides": {f"/{space.path}/trails": rrb.VisibleTimeRanges([_last(TRAIL_S)])},
    }
    if space.axes in _AXES:
        eye = space.eye and rrb.EyeControls3D(position=space.eye.position, look_target=space.eye.target)
        return rrb.Spatial3DView(origin=space.path, line_grid=_LINES, eye_controls=eye, **options)
    return rrb.Spatial2DView(origin=origin, **options)


def _side(layout: Layout) -> Any:
    views = [_legend(), _curve("sizes", "Features per hypothesis", legend=False)]
    if layout.scored:
        views.append(_curve("scores", "Agreement with the truth", range_=(0.0, 1.02)))
    # Each source has the same colour in both; the legend needs the height of a line per source.
    views += [_curve("rates", "Rates, Hz"), _curve("lags", "Lags, ms", legend=False)]
    return rrb.Vertical(*views, row_shares=[4] * (len(views) - 2) + [6, 4])


def _legend() -> Any:
    across = LEGEND_WIDTH * (LEGEND_COLUMNS - 0.5)
    down = [-2.2 * LEGEND_LIFT, LEGEND_HEIGHT * (LEGEND_ROWS - 0.2)]
    bounds = rrb.VisualBounds2D(x_range=[-LEGEND_WIDTH / 2, across], y_range=down)
    return rrb.Spatial2DView(
        origin="legend", name="Hypotheses: id, state, features", background=_GROUND, visual_bounds=bounds
    )


def _curve(origin: str, name: str, range_: tuple[float, float] | None = None, *, legend: bool = True) -> Any:
    return rrb.TimeSeriesView(
        origin=origin,
        name=name,
        plot_legend=rrb.PlotLegend(corner="LeftTop", visible=legend),
        axis_y=None if range_ is None else rrb.ScalarAxis(range=range_, zoom_lock=True),
        time_ranges=_last(CURVES_S),
    )
