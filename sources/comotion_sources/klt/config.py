"""Parameters of the KLT tracker."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class TrackerConfig(BaseModel):
    """Parameters of :class:`~comotion_sources.klt.tracker.Tracker`; lengths in px or m as stated."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    max_features: Annotated[int, Field(ge=1, le=30_000)] = 400
    """Feature budget of the whole image; OpenCV samples no more at once."""
    respawn_every: Annotated[int, Field(ge=1)] = 15
    """Frames between two looks for new corners."""
    spawn_limit: Annotated[int, Field(ge=1)] | None = None
    """Most new features per look; None: whatever the budget leaves. The thesis takes 100."""
    cell: Annotated[int, Field(ge=4)] = 16
    """Edge of a grid cell, px; a new feature needs an empty one."""
    tiles: Annotated[int, Field(ge=1, le=64)] = 4
    """The image is cut in tiles x tiles parts that share the budget evenly."""
    quality: Annotated[float, Field(gt=0, le=1)] = 0.005
    """Least corner quality (smaller eigenvalue) as a share of the best one in the image."""
    quality_floor: NotNegative = 2e-4
    """Least corner quality of any feature: that of image noise of two grey levels."""
    window: Annotated[int, Field(ge=5, le=101)] = 15
    """Edge of the Lucas-Kanade window, px."""
    levels: Annotated[int, Field(ge=0, le=8)] = 3
    """Pyramid levels above the image itself."""
    iterations: Annotated[int, Field(ge=1, le=100)] = 20
    """Most Lucas-Kanade iterations per level."""
    epsilon: Positive = 0.01
    """A step shorter than this ends the iterations, px."""
    fb_relative: NotNegative = 0.01
    """Forward-backward check: share of the squared motions; the thesis prints 0.5, its source 0.01."""
    fb_absolute: NotNegative = 0.1
    """Forward-backward check: what is allowed in any case, px²; the thesis and its source have 0.5.

    Chosen on three rendered scenes with truth: of the features alive after 1 s, 98.1 % are on the body they
    were born on without depth (0.5: 97.7 %), and the tenth that drifts most drifts 8.0 mm (0.5: 9.5 mm; with
    a share of 0.5: 10.7 mm). It costs 6 % of the features a second, which respawning makes up for.
    """
    likeness: Annotated[float, Field(ge=-1, le=1)] = 0.8
    """Least correlation of a feature's birth patch with what is there."""
    anchor_reach: Positive = 2.0
    """Farthest that the birth patch may be found from where Lucas-Kanade went, px."""
    birth_sigma: Positive = 0.05
    """A new feature's texture must fix it to this in any direction, px, under noise of two grey levels.

    Shadows and brightness that changes by a slope are not texture. At 0.1 an edge that a shadow crosses
    still counts as a corner, and goes with the shadow.
    """
    min_distance: NotNegative = 4.0
    """Of two features closer than this the younger one goes, px."""
    pixel_sigma: Positive = 0.1
    """One-sigma noise of a perfectly tracked feature, px."""
    residual_gain: NotNegative = 1.0
    """How much the tracking residual adds to that."""
    max_step: Positive = 0.05
    """Longest credible 3-D step between two frames a thirtieth of a second apart, m."""
    depth_noise: NotNegative = 1.5e-3
    """One-sigma noise of the depth at 1 m; it grows with the square of the depth. m per m²."""
    depth_floor: Positive = 5e-4
    """Least noise of the depth, m."""
    depth_edge: Positive = 0.01
    """Depth that departs from a plane by more than this plus four sigma is an edge, m."""
    max_missing: Annotated[int, Field(ge=0)] = 5
    """Frames in a row that a feature may be without depth before it ends."""
