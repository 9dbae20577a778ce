"""Parameters of the default method in spaces of unit px.

Its other numbers are constants beside the code that uses them: they were chosen together on public sequences;
docs/research/pixels.md says how.
"""

from typing import Annotated

from pydantic import Field

from .groups import Group

Count = Annotated[int, Field(ge=1, le=100_000)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class PixelsConfig(Group):
    """Parameters of grouping in pixel space."""

    key_frames: Annotated[int, Field(ge=2, le=1000)] = Field(
        default=24, description="instants of the window that trajectories are compared at"
    )
    most_tracks: Count = Field(
        default=1200, description="most trajectories that are compared; the others follow their neighbours"
    )
    local_motions: Count = Field(default=600, description="number of local affine motions")
    drift: Weight = Field(
        default=0.02,
        description="share of a motion in the image by which features drift or a lens distorts it",
    )
    smallest: Count = Field(default=5, description="members below which a group dissolves")
