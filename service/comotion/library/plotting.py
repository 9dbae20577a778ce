"""Draws labelled trajectories. Needs matplotlib, imported when a figure is drawn."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from comotion_schemas import UNDETERMINED, HypothesisUpdate, Joint
from comotion_schemas.colours import RGB, Palette, marker
from comotion_schemas.naming import Names, joint_words, named
from comotion_schemas.types import Unit

from ..arrays import Floats, Labels, last_true

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Half length of the axis of a joint, in standard deviations of all positions.
_REACH = 0.8


def draw(
    updates: Sequence[HypothesisUpdate],
    positions: Mapping[str, Floats],
    labels: Mapping[str, Labels],
    unit: Unit,
    names: Names | None = None,
) -> "Figure":
    """Draw every trajectory in the colour of the hypothesis that it had last.

    Parameters
    ----------
    updates
        In order.
    positions, labels
        float64 [T, N, dim] and int64 [T, N] by source.
    unit
        Of the positions.
    names
        Names of hypotheses by id.

    Raises
    ------
    ModuleNotFoundError
        If matplotlib is not installed.
    """
    figure = _figure()
    palette = Palette()
    for update in updates:
        palette.see(update.hypotheses)
    dim = next(iter(positions.values())).shape[2]
    axes = figure.add_subplot(projection="3d" if dim == 3 else None)
    paths: dict[int, list[Floats]] = {}
    for source, states in positions.items():
        for k, label in enumerate(last_labels(labels[source]).tolist()):
            seen = np.isfinite(states[:, k, 0])
            if seen.any():
                paths.setdefault(label, []).append(states[seen, k])
    resting = {h.id for h in updates[-1].hypotheses if h.state == "static"}
    for label, group in sorted(paths.items()):
        hypothesis = label if label >= 0 else UNDETERMINED
        name = named(hypothesis, names or {}) + (" at rest" if hypothesis in resting else "")
        _draw_group(axes, group, hypothesis, name, palette.colour(hypothesis))
    reach = _REACH * float(np.std(np.concatenate([path for group in paths.values() for path in group])))
    for joint in updates[-1].joints:
        _draw_joint(axes, joint, joint_words(joint, names), reach)
    for name in "xyz"[:dim]:
        getattr(axes, f"set_{name}label")(f"{name} [{unit}]")
    axes.set_aspect("equal")
    if unit == "px":
        axes.invert_yaxis()
    axes.set_title(f"{sum(map(len, paths.values()))} features by hypothesis")
    # Outside of the axes, the legend hides nothing.
    figure.legend(loc="outside right upper", fontsize=8)
    return figure


def _figure() -> "Figure":
    """An empty figure that a notebook shows, as it does those of pyplot, which is not needed."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise ModuleNotFoundError("matplotlib is not installed: pip install 'comotion[plot]'") from None

    class Shown(Figure):
        def _repr_png_(self) -> bytes:
            file = BytesIO()
            self.savefig(file, format="png", bbox_inches="tight", dpi=72)
            return file.getvalue()

    figure = Shown(figsize=(8, 6), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def last_labels(labels: Labels) -> Labels:
    """The last label of each feature, int64 [N]; -1 where it never had one."""
    last = labels[last_true(labels.T >= 0), np.arange(labels.shape[1])]
    return np.where((labels >= 0).any(axis=0), last, -1)


def _draw_group(axes: Any, paths: list[Floats], hypothesis: int, name: str, rgb: RGB) -> None:
    shade = tuple(value / 255 for value in rgb)
    name = "undetermined" if hypothesis == UNDETERMINED else name
    for path in paths:
        axes.plot(*path.T, color=shade, linewidth=0.8, alpha=0.5)
    axes.plot(
        *np.array([path[-1] for path in paths]).T,
        linestyle="",
        marker=marker(hypothesis),
        markersize=4.5,
        color=shade,
        label=f"{name} ({len(paths)})",
    )


def _draw_joint(axes: Any, joint: Joint, words: str, reach: float) -> None:
    """Draw the axis of a hinge or slide, or in 2-D the point of a hinge."""
    if joint.point is None or joint.kind not in {"revolute", "prismatic"}:
        return
    along = np.zeros(len(joint.point)) if joint.axis is None else reach * np.array(joint.axis)
    ends = np.array([joint.point - along, joint.point + along])
    axes.plot(*ends.T, color="black", linestyle="--", marker=".", linewidth=1.2, label=words)
