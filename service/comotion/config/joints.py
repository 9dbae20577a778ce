"""Parameters of the joints between hypotheses of a metric space."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class JointsConfig(BaseModel):
    """When a pair of hypotheses has a joint, and how much time may be spent on it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    pairs: Annotated[int, Field(ge=0, le=100)] = Field(
        1, description="pairs of hypotheses that are judged together, every 150 ms at most; 0: no joints"
    )
    least_turn: Annotated[float, Field(ge=0, le=6)] = Field(
        0.2, description="rad; a pair that has turned and moved less is undetermined"
    )
    least_shift: Annotated[float, Field(ge=0, le=1000)] = Field(
        0.03, description="m; a pair that has turned and moved less is undetermined"
    )
    least_confidence: Annotated[float, Field(ge=0.5, le=1)] = Field(
        0.95, description="probability from which on a kind of joint is published"
    )
    most_axis_sigma: Annotated[float, Field(gt=0, le=3)] = Field(
        0.15, description="rad; a pair whose axis is less well known is undetermined"
    )
    reach: Annotated[float, Field(ge=0, le=10)] = Field(
        0.5,
        description="share of the extent of the larger of two moving bodies, and of the smaller where one "
        "rests; pairs with a wider gap between their boxes cannot touch, and are not tried",
    )
    key_states: Annotated[int, Field(ge=2, le=1000)] = Field(
        40, description="states of a pair that are remembered beyond the window"
    )
