"""The result of grouping: labels, hypotheses, motion, joints, tables and plots."""

from __future__ import annotations  # help() shows short types

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Hypothesis, HypothesisUpdate, Joint
from comotion_schemas.errors import KnownError
from comotion_schemas.naming import joint_words
from comotion_schemas.text import counted
from comotion_schemas.types import Unit

from ..arrays import Floats, Labels
from .plotting import draw

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


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
        return dict(_tracks(self.updates, origin))

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
        import pandas  # noqa: PLC0415 - no dependency of ours

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
        figure = draw(self.updates, self._positions, self.by_source, self._unit, names)
        if path is not None:
            figure.savefig(path, bbox_inches="tight")  # a legend outside would push labels off the page
        return figure


def _tracks(updates: Sequence[HypothesisUpdate], origin: float) -> Iterator[tuple[int, Track]]:
    rows: dict[int, list[tuple[int, Hypothesis]]] = {}
    for update in updates:
        for h in update.hypotheses:
            if not h.absent:
                rows.setdefault(h.id, []).append((update.stamp_ns, h))
    for number, seen in rows.items():
        dim = len(seen[0][1].centroid)
        unknown = [math.nan] * 4 if dim == 3 else math.nan
        yield (
            number,
            Track(
                np.array([origin + stamp / 1e9 for stamp, _ in seen]),
                np.array([h.centroid for _, h in seen]),
                np.array([h.pose.translation if h.pose else [math.nan] * dim for _, h in seen]),
                np.array([h.pose.rotation if h.pose else unknown for _, h in seen]),
            ),
        )
