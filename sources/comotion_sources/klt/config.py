"""Parameters of the KLT tracker."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_BIRTH_SIGMA, _MOVING_BIRTH_SIGMA = 0.05, 0.025


class TrackerConfig(BaseModel):
    """Parameters of :class:`~comotion_sources.klt.tracker.Tracker`; lengths in px or m as stated."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    max_features: Annotated[int, Field(ge=1, le=30_000)] = 400
    """Most features in the image; the limit 30 000 is that of one call of cv2.remap."""
    respawn_every: Annotated[int, Field(ge=1)] = 5
    """Frames between two searches for new corners: on a hand a feature lives for half a second."""
    spawn_limit: Annotated[int, Field(ge=1)] | None = None
    """Most new features per search; None: up to `max_features`. The thesis uses 100."""
    distance: Annotated[int, Field(ge=1)] = 8
    """Least distance of a new feature from the others, px."""
    quality: Annotated[float, Field(gt=0, le=1)] = 0.005
    """Least corner quality (smaller eigenvalue) as a share of the best one in the image."""
    window: Annotated[int, Field(ge=5, le=101)] = 15
    """Edge of the Lucas-Kanade window, px."""
    levels: Annotated[int, Field(ge=0, le=8)] = 3
    """Pyramid levels above the image itself."""
    iterations: Annotated[int, Field(ge=1, le=100)] = 20
    """Most Lucas-Kanade iterations per level."""
    epsilon: Positive = 0.01
    """The iterations end after a step shorter than this, px."""
    fb_relative: NotNegative = 0.01
    """Forward-backward check: share of the squared motions. The thesis prints 0.5, its reference 0.01."""
    fb_absolute: NotNegative = 0.1
    """Forward-backward check: constant part of the limit, px². The thesis and its reference use 0.5.

    Chosen on three rendered scenes with truth: without depth, 98.1 % of the features that exist after
    1 s are still on their body (0.5: 97.7 %), and the 90th percentile of the drift is 8.0 mm (0.5:
    9.5 mm; with a share of 0.5: 10.7 mm). It ends 6 % more features a second, which are replaced.
    """
    likeness: Annotated[float, Field(ge=-1, le=1)] = 0.8
    """Least correlation of the template of a feature (its patch at birth) with the image. A feature that is
    half a window away ends if the image shows its template at its place of birth still: it has slid along an
    edge.
    """
    birth_sigma: Positive | None = None
    """Most position noise of a new feature in any direction, px, under noise of two grey levels. None: 0.05,
    and 0.025 with `moving`.

    A linear change of brightness does not count as texture. At 0.1 an edge that a shadow crosses is still
    accepted as a corner, and then moves with the shadow. Before a camera that moves, a feature on a seam of
    the table may slide along it: at 0.05, 21 and 15 % of the features at rest slide by more than 5 mm, at
    0.025 2 and 1 % (workcell ``eye-in-hand``, seeds 0 and 2).
    """
    pixel_sigma: Positive = 0.1
    """One-sigma noise of a feature in the image, px."""
    moving: bool = False
    """The camera is carried: of `birth_sigma` the smaller default holds."""
    depth_noise: NotNegative = 1.5e-3
    """One-sigma noise of the depth at 1 m; it grows with the square of the depth. m per m²."""
    depth_floor: Positive = 5e-4
    """Least noise of the depth, m."""
    depth_edge: Positive = 0.01
    """Depth that deviates from a plane by more than this plus four sigma is an edge, m."""
    max_missing: Annotated[int, Field(ge=0)] = 5
    """Most consecutive frames without depth before a feature ends."""

    @property
    def corner_sigma(self) -> float:
        """`birth_sigma`, or its default for a camera that rests or moves; px."""
        if self.birth_sigma is not None:
            return self.birth_sigma
        return _MOVING_BIRTH_SIGMA if self.moving else _BIRTH_SIGMA
