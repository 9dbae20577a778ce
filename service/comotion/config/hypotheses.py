"""Parameters of hypotheses over time: confirmation and memory, for all methods."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class HypothesesConfig(BaseModel):
    """When a hypothesis is confirmed, and how long one without current members is remembered."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    confirm: Annotated[float, Field(ge=0, le=60)] = Field(
        default=0.5, description="s that a hypothesis, a loss or a return must last until it makes an event"
    )
    members: Annotated[int, Field(ge=2, le=1000)] = Field(
        default=3,
        description="current members that confirm a hypothesis; 2 in a space with less than twice as many "
        "trajectories",
    )
    memory: Annotated[float, Field(ge=0, le=86_400)] = Field(
        default=60.0, description="s for which a hypothesis without current members is remembered"
    )
    remembered: Annotated[int, Field(ge=0, le=1000)] = Field(
        default=32, description="hypotheses without current members that are remembered in a space"
    )
