"""Bodies that are fitted to rows of a scene, each once, and what they cost (steps 6 and 7)."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats, Ints
from ..config import RigidConfig
from .costs import Costs, body_costs_of, deformation, opening_price, outlier_costs, restless_price
from .frames import Frames
from .procrustes import Body, fit_body, static_body
from .rest import settled
from .sliding import with_sliders


@dataclass(frozen=True)
class Fitted:
    """A body that was fitted to rows.

    Attributes
    ----------
    body, kept
        With a pose of its own in each frame, and as its costs are computed: :func:`~.rest.settled` or not.
    owners
        intp [m], trajectories that it was fitted to; none for the static body.
    soft
        Variance of its deformation.
    cost, squared
        float64 [N], what each trajectory costs under `kept`, nat; float64 [P], mean squared
        residual of each row.
    """

    body: Body
    kept: Body
    owners: Ints
    soft: float
    cost: Floats
    squared: Floats


class Fits:
    """The bodies of one scene. What was fitted to the same rows before is not fitted again."""

    def __init__(self, frames: Frames, config: RigidConfig) -> None:
        self._frames, self._config = frames, config
        self._bodies: dict[bytes, Body] = {}
        self._known: dict[tuple[bytes, bool], Fitted] = {}

    def of(self, rows: list[Ints], *, still: bool) -> list[Fitted]:
        """The static body, and one for each of `rows` intp [m], m > 1; `still`: settled."""
        nobody = np.zeros(0, np.intp)
        return [self._fitted(some, still=still) for some in [nobody, *rows] if len(some) != 1]

    def costs(self, some: list[Fitted]) -> Costs:
        """What all trajectories cost under some bodies, with those that slide on one."""
        frames, config, bodies = self._frames, self._config, [one.kept for one in some]
        seen, outlier = outlier_costs(frames, config)
        body, slides = with_sliders(frames, bodies, np.stack([one.cost for one in some], 1), seen, config)
        return Costs(
            body,
            outlier,
            opening=np.array([opening_price(one, config) for one in bodies]),
            restless=np.array([restless_price(one, config) for one in bodies]),
            soft=np.array([one.soft for one in some]),
            slides=slides,
            squared=np.stack([one.squared for one in some], 1),
        )

    def _fitted(self, rows: Ints, *, still: bool) -> Fitted:
        key = rows.tobytes(), still
        if key not in self._known:
            frames, config, body = self._frames, self._config, self._body(rows)
            kept = settled(frames, body, config) if still else body
            soft = deformation(frames, kept, config)
            cost, squared = body_costs_of(frames, [kept], np.array([soft]), config)
            owners = np.unique(frames.owner[rows])
            self._known[key] = Fitted(body, kept, owners, soft, cost[:, 0], squared[:, 0])
        return self._known[key]

    def _body(self, rows: Ints) -> Body:
        key = rows.tobytes()
        if key not in self._bodies:
            frames = self._frames
            self._bodies[key] = fit_body(frames, rows) if len(rows) else static_body(len(frames.stamps))
        return self._bodies[key]
