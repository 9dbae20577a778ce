"""Parameters of single spaces."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field


class SpaceConfig(BaseModel):
    """What is known of a coordinate space; what is not, its first source says."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    unit: Literal["m", "px"] | None = Field(
        None, description="m or px; batches of another unit are refused; null: that of the first source"
    )
    dim: Annotated[int, Field(ge=2, le=3)] | None = Field(
        None, description="coordinates; batches of another number are refused; null: that of the first source"
    )
    moving: bool | None = Field(
        None,
        description="its frame is carried, as that of a camera in the hand: the largest body is the world, "
        "and what is published is relative to it; null: if all its sources say so",
    )
