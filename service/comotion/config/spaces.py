"""Parameters of single spaces."""

from pydantic import BaseModel, ConfigDict, Field


class SpaceConfig(BaseModel):
    """What is known of a coordinate space."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    moving: bool = Field(
        False,
        description="its frame is carried, as that of a camera in the hand: the largest body is the world, "
        "and what is published is relative to it",
    )
