"""Fits bodies to rows of a scene and computes their costs (steps 6 and 7), once for the same rows."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats, Ints
from ..geometry.body import Body, fit_body, settled, static_body
from ..geometry.frames import Frames
from .costs import Costs, body_costs_of, deformation, outlier_costs, path_price
from .sliding import with_sliders


@dataclass(frozen=True)
class Fitted:
    """A body that was fitted to rows.

    Attributes
    ----------
    body, costed
        With a pose of its own in each frame, and the one of which the costs are: `body`, or
        :func:`~comotion.geometry.body.settled`.
    owners
        intp [m], trajectories that it was fitted to; none for the static body.
    soft
        Variance of its deformation.
    cost, squared
        float64 [N], what each trajectory costs under `costed`, nat; float64 [P], mean squared
        residual of each row.
    """

    body: Body
    costed: Body
    owners: Ints
    soft: float
    cost: Floats
    squared: Floats


class Fits:
    """The bodies of one scene; a second fit to the same rows is read from memory."""

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self._seen, self._outlier = outlier_costs(frames)
        self._bodies: dict[bytes, Body] = {}
        self._fitted: dict[tuple[bytes, bool], Fitted] = {}

    def of(self, rows: list[Ints], *, still: bool) -> list[Fitted]:
        """The static body, and one for each of `rows` intp [m] with m > 1; `still`: settled."""
        wanted = {(group.tobytes(), still): group for group in rows if len(group) > 1}
        wanted = {(b"", False): np.zeros(0, np.intp)} | wanted
        self._fit({key: group for key, group in wanted.items() if key not in self._fitted})
        return [self._fitted[key] for key in wanted]

    def costs(self, fitted: list[Fitted]) -> Costs:
        """What all trajectories cost under some bodies, with those that slide on one."""
        frames, bodies = self._frames, [body.costed for body in fitted]
        birth = frames.config.birth_price
        body_cost = np.stack([body.cost for body in fitted], 1)
        body_cost, slides = with_sliders(frames, bodies, body_cost, self._seen)
        return Costs(
            body_cost,
            self._outlier,
            opening=np.array([path_price(body.dof, body.free, birth) for body in bodies]),
            soft=np.array([body.soft for body in fitted]),
            slides=slides,
            squared=np.stack([body.squared for body in fitted], 1),
        )

    def _fit(self, groups: dict[tuple[bytes, bool], Ints]) -> None:
        if not groups:
            return
        frames = self._frames
        bodies = [self._body(rows) for rows in groups.values()]
        costed = [
            settled(frames, body) if still else body for body, (_, still) in zip(bodies, groups, strict=True)
        ]
        soft = np.array([deformation(frames, body) for body in costed])
        cost, squared = body_costs_of(frames, costed, soft)
        for k, (key, rows) in enumerate(groups.items()):
            columns = float(soft[k]), cost[:, k], squared[:, k]
            self._fitted[key] = Fitted(bodies[k], costed[k], np.unique(frames.owner[rows]), *columns)

    def _body(self, rows: Ints) -> Body:
        key = rows.tobytes()
        if key not in self._bodies:
            frames = self._frames
            self._bodies[key] = fit_body(frames, rows) if len(rows) else static_body(len(frames.stamps))
        return self._bodies[key]
