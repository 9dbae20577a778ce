"""The parameters of the fusion: those of event time, and a group for each method."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from .flat_names import GROUPS, MEMBERS, nested
from .hypotheses import HypothesesConfig
from .joints import JointsConfig
from .limits import LimitsConfig
from .linking import Camera, LinkingConfig
from .pixels import PixelsConfig
from .rigid import RigidConfig
from .spaces import SpaceConfig
from .thesis import Clustering, ThesisConfig

Method = Literal["comotion", "thesis"]


class FusionConfig(BaseModel):
    """Parameters of :class:`comotion.Fusion`; frozen, validated, dumpable.

    The flat names that parameters had before they were grouped (``sigma_switch``, ``motion``,
    ``cameras`` ...) are accepted, and can be read. A parameter given by both names is an error.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

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
        description="what is known of single spaces, by name: `unit`, `dim`, and `moving` for a carried "
        "camera",
    )

    @model_validator(mode="before")
    @classmethod
    def _nest(cls, values: Any) -> Any:
        return nested(values) if isinstance(values, Mapping) else values

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Copy with some parameters changed, by their nested or flat names; not validated."""
        changed = {GROUPS.get(name, name): value for name, value in (update or {}).items()}
        for name in changed.keys() & MEMBERS.keys():
            group, value = MEMBERS[name], changed.pop(name)
            before = changed.get(group, getattr(self, group))
            changed[group] = before.model_copy(update={name: value})
        return super().model_copy(update=changed, deep=deep)

    @property
    def sigma_switch(self) -> float | None:
        """Flat name of ``thesis.sigma_switch``."""
        return self.thesis.sigma_switch

    @property
    def v_move(self) -> float | Literal["auto"] | None:
        """Flat name of ``thesis.v_move``."""
        return self.thesis.v_move

    @property
    def stop_affinity(self) -> float:
        """Flat name of ``thesis.stop_affinity``."""
        return self.thesis.stop_affinity

    @property
    def clustering(self) -> Clustering:
        """Flat name of ``thesis.clustering``."""
        return self.thesis.clustering

    @property
    def motion(self) -> RigidConfig:
        """Former name of ``rigid``."""
        return self.rigid

    @property
    def cameras(self) -> dict[str, Camera]:
        """Flat name of ``linking.cameras``."""
        return self.linking.cameras


def to_ns(seconds: float) -> int:
    """Seconds as whole nanoseconds."""
    return round(seconds * 1e9)
