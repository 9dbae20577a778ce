"""The parameters of the fusion: those of event time, and a group for each method."""

from typing import Annotated, Literal

from pydantic import Field

from .groups import (
    Group,
    HypothesesConfig,
    JointsConfig,
    LimitsConfig,
    LinkingConfig,
    PixelsConfig,
    RigidConfig,
    SpaceConfig,
    ThesisConfig,
)

Method = Literal["comotion", "thesis"]


class FusionConfig(Group):
    """Parameters of :class:`comotion.Fusion`; frozen, validated, dumpable."""

    method: Method = Field(default="comotion", description="how hypotheses are inferred")
    window: Annotated[float, Field(gt=0, le=600)] = Field(
        default=10.0, description="s; observations older than this leave the trajectories"
    )
    period: Annotated[float, Field(ge=0.005, le=60)] = Field(default=0.1, description="s between updates")
    allowed_lateness: Annotated[float, Field(ge=0, le=10)] = Field(
        default=0.2, description="s behind the watermark up to which an observation is still inserted"
    )
    max_lag: Annotated[float, Field(ge=0, le=10)] = Field(
        default=0.5, description="s the watermark may stay behind the clock for a slow source"
    )
    source_timeout: Annotated[float, Field(gt=0, le=60)] = Field(
        default=1.0, description="s without data after which a source no longer holds the watermark"
    )
    track_timeout: Annotated[float, Field(gt=0, le=60)] = Field(
        default=0.5,
        description="s without observation after which a trajectory is outdated (or 3 source periods)",
    )
    max_tracks: Annotated[int, Field(ge=1, le=100_000)] = Field(
        default=5000, description="trajectories kept at once; further ones are refused"
    )

    thesis: ThesisConfig = Field(
        default_factory=ThesisConfig, description="the method of the thesis, in spaces of either unit"
    )
    rigid: RigidConfig = Field(
        default_factory=RigidConfig, description="the default method in spaces of unit m"
    )
    pixels: PixelsConfig = Field(
        default_factory=PixelsConfig, description="the default method in spaces of unit px"
    )
    hypotheses: HypothesesConfig = Field(
        default_factory=HypothesesConfig, description="confirmation and memory, for all methods"
    )
    linking: LinkingConfig = Field(
        default_factory=LinkingConfig, description="links between spaces in pixels and metric spaces"
    )

    joints: JointsConfig = Field(
        default_factory=JointsConfig, description="joints between the hypotheses of a metric space"
    )
    limits: LimitsConfig = Field(
        default_factory=LimitsConfig, description="bounds on what sources may make the service hold"
    )

    spaces: dict[str, SpaceConfig] = Field(
        default_factory=dict,
        description="what is known of single spaces, by name: `unit`, `dim`, `moving` for a carried camera, "
        "and `sources`, the names of those that may publish in it",
    )


def to_ns(seconds: float) -> int:
    """Seconds as whole nanoseconds."""
    return round(seconds * 1e9)
