"""The result of grouping: labels, hypotheses, motion, joints, tables, and plots, which need matplotlib."""

from __future__ import annotations  # help() shows short types

import math
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED, Hypothesis, HypothesisUpdate, Joint
from comotion_schemas.colours import RGB, Palette, marker
from comotion_schemas.errors import KnownError
from comotion_schemas.naming import joint_words, named
from comotion_schemas.text import counted
from comotion_schemas.types import Unit

from ..arrays import Floats, Labels, last_true

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

# Half length of the axis of a joint, in standard deviations of all positions.
_REACH = 0.8


@dataclass(frozen=True)
class Track:
    """The motion of one hypothesis over K updates.

    Attributes
    ----------
    times
        float64 [K], s, as the times that were given.
    centroid
        float64 [K, dim], mean position of the members.
    translation, rotation
        float64 [K, dim], and [K, 4] quaternions (x, y, z, w) or in 2-D angles [K] in rad: motion since
        birth, x(t) = R x(born) + translation. NaN where unknown: in pixels, and with the thesis method.
    """

    times: Floats
    centroid: Floats
    translation: Floats
    rotation: Floats


@dataclass(frozen=True, eq=False, repr=False)
class Grouping:
    """What :func:`group` has found. In NumPy functions it stands for its :attr:`labels`.

    Attributes
    ----------
    by_source
        Labels of every source: int64 [T, N], the hypothesis of each feature as known at that instant, and
        -1 where it is undetermined or unseen.
    updates
        The updates of the core, in order; the last one is what is known at the end.
    """

    by_source: dict[str, Labels]
    updates: list[HypothesisUpdate]
    _positions: dict[str, Floats]
    _times: dict[str, Floats]
    _unit: Unit

    @property
    def labels(self) -> Labels:
        """Labels of the only source, int64 [T, N].

        Raises
        ------
        ValueError
            If there are several sources; see :attr:`by_source`.
        """
        if len(self.by_source) != 1:
            raise KnownError(f"there are {len(self.by_source)} sources: use by_source[name]")
        return next(iter(self.by_source.values()))

    @property
    def hypotheses(self) -> list[Hypothesis]:
        """The hypotheses at the end, with their poses, velocities and boxes."""
        return self.updates[-1].hypotheses

    @property
    def joints(self) -> list[Joint]:
        """The joints at the end."""
        return self.updates[-1].joints

    def joints_in_words(self, names: Mapping[int, str] | None = None) -> list[str]:
        """The joints at the end as "2 turns on 1, 0 to 65°", with names by id where they are given."""
        return [joint_words(joint, names) for joint in self.joints]

    @property
    def poses(self) -> dict[int, Track]:
        """Motion of every hypothesis over time, by id."""
        origin = min(float(times[0]) for times in self._times.values())
        rows: dict[int, list[tuple[int, Hypothesis]]] = {}
        for update in self.updates:
            for h in update.hypotheses:
                if not h.absent:
                    rows.setdefault(h.id, []).append((update.stamp_ns, h))
        return {number: _track(seen, origin) for number, seen in rows.items()}

    def __repr__(self) -> str:
        shapes = ", ".join(f"{rows} x {columns}" for rows, columns in map(np.shape, self.by_source.values()))
        rest = sum(h.state == "static" for h in self.hypotheses)
        return f"Grouping({shapes}, {counted(len(self.hypotheses), 'hypothesis')}, {rest} at rest)"

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each feature and instant at which it was seen.

        Returns
        -------
        DataFrame
            Columns ``source``, ``time`` (s), ``feature``, ``hypothesis`` (-1: undetermined), and ``x``, ``y``
            and in space ``z``.

        Raises
        ------
        ModuleNotFoundError
            If pandas is not installed: ``pip install pandas``.
        """
        import pandas  # no dependency of ours

        parts = []
        for name, states in self._positions.items():
            rows, features = np.nonzero(np.isfinite(states[..., 0]))
            columns = {
                "source": np.full(len(rows), name),
                "time": self._times[name][rows],
                "feature": features,
                "hypothesis": self.by_source[name][rows, features],
            }
            parts.append(columns | dict(zip("xyz", states[rows, features].T, strict=False)))
        return pandas.DataFrame({key: np.concatenate([part[key] for part in parts]) for key in parts[0]})

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.labels, dtype=dtype, copy=copy)

    def plot(self, path: str | Path | None = None, names: Mapping[int, str] | None = None) -> Figure:
        """Draw the trajectories in the colours of their hypotheses at the end, and the joints.

        Parameters
        ----------
        path
            File to write; its suffix is the format. None: none.
        names
            Names of hypotheses by id.

        Raises
        ------
        ModuleNotFoundError
            If matplotlib is not installed: ``pip install 'comotion[plot]'``.
        """
        figure, palette, paths = _figure(), Palette(), self._paths()
        for update in self.updates:
            palette.see(update.hypotheses)
        dim = next(iter(self._positions.values())).shape[2]
        axes = figure.add_subplot(projection="3d" if dim == 3 else None)
        resting = {h.id for h in self.hypotheses if h.state == "static"}
        for label, group in sorted(paths.items()):
            hypothesis = label if label >= 0 else UNDETERMINED
            name = named(hypothesis, names or {}) + (" at rest" if hypothesis in resting else "")
            _draw_group(axes, group, hypothesis, name, palette.colour(hypothesis))
        reach = _REACH * float(np.std(np.concatenate([path for group in paths.values() for path in group])))
        for joint in self.joints:
            _draw_joint(axes, joint, joint_words(joint, names), reach)
        for axis in "xyz"[:dim]:
            getattr(axes, f"set_{axis}label")(f"{axis} [{self._unit}]")
        axes.set_aspect("equal")
        if self._unit == "px":
            axes.invert_yaxis()
        axes.set_title(f"{sum(map(len, paths.values()))} features by hypothesis")
        # Outside of the axes, the legend hides nothing.
        figure.legend(loc="outside right upper", fontsize=8)
        if path is not None:
            figure.savefig(path, bbox_inches="tight")  # a legend outside would push labels off the page
        return figure

    def _paths(self) -> dict[int, list[Floats]]:
        """Trajectories by the last hypothesis of their features, -1 where they never had one."""
        paths: dict[int, list[Floats]] = {}
        for source, states in self._positions.items():
            labels = self.by_source[source]
            last = labels[last_true(labels.T >= 0), np.arange(labels.shape[1])]
            for k, label in enumerate(np.where((labels >= 0).any(axis=0), last, -1).tolist()):
                seen = np.isfinite(states[:, k, 0])
                if seen.any():
                    paths.setdefault(label, []).append(states[seen, k])
        return paths


def _track(seen: list[tuple[int, Hypothesis]], origin: float) -> Track:
    """Motion of a hypothesis by its stamps and descriptions; the first stamp of all is at `origin`."""
    dim = len(seen[0][1].centroid)
    unknown = [math.nan] * 4 if dim == 3 else math.nan
    return Track(
        np.array([origin + stamp / 1e9 for stamp, _ in seen]),
        np.array([h.centroid for _, h in seen]),
        np.array([h.pose.translation if h.pose else [math.nan] * dim for _, h in seen]),
        np.array([h.pose.rotation if h.pose else unknown for _, h in seen]),
    )


def _figure() -> Figure:
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
