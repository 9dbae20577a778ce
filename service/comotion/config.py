"""Every parameter of the fusion, with unit, default and bounds."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from .linking.camera import Camera
from .rigid.config import MotionConfig

Method = Literal["comotion", "thesis"]
Clustering = Literal["divisive-kmeans", "gmm-bic", "eigengap", "eigengap-normalized"]
Unit = Literal["m", "px"]

_SIGMA_SWITCH: dict[Unit, float] = {"m": 0.02, "px": 8.0}
_V_MOVE: dict[Unit, float] = {"m": 0.1, "px": 20.0}

# Bounded away from zero: its square must not vanish.
Positive = Annotated[float, Field(ge=1e-9, le=1e9)]


class FusionConfig(BaseModel):
    """Parameters of :class:`comotion.Fusion`; frozen, validated, dumpable."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: Method = Field("comotion", description="how hypotheses are inferred")
    window: Annotated[float, Field(gt=0, le=600)] = Field(
        10.0, description="s; observations older than this leave the trajectories"
    )
    period: Annotated[float, Field(ge=0.005, le=60)] = Field(0.1, description="s between updates")
    sigma_switch: Positive | None = Field(
        None,
        description="m or px; standard deviation of a distance where the affinity is 0.5 "
        "(thesis method); null: 0.02 m or 8 px",
    )
    v_move: Positive | Literal["auto"] | None = Field(
        "auto",
        description="m/s or px/s; speed at which a feature weighs 0.9 (thesis method); "
        "auto: 0.1 m/s or 20 px/s, null: equal weights",
    )
    stop_affinity: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.4, description="a cluster is split while its smallest affinity is not above this (thesis method)"
    )
    clustering: Clustering = Field("divisive-kmeans", description="clustering of the thesis method")
    allowed_lateness: Annotated[float, Field(ge=0, le=10)] = Field(
        0.2, description="s behind the watermark up to which an observation is still inserted"
    )
    max_lag: Annotated[float, Field(ge=0, le=10)] = Field(
        0.5, description="s the watermark may stay behind the clock for a slow source"
    )
    source_timeout: Annotated[float, Field(gt=0, le=60)] = Field(
        1.0, description="s without data after which a source no longer holds the watermark"
    )
    track_timeout: Annotated[float, Field(gt=0, le=60)] = Field(
        0.5, description="s without observation after which a trajectory is outdated (or 3 source periods)"
    )
    max_tracks: Annotated[int, Field(ge=1, le=100_000)] = Field(
        5000, description="trajectories kept at once; further ones are refused"
    )

    motion: MotionConfig = Field(
        default_factory=MotionConfig, description="the default method in spaces of unit m"
    )
    cameras: dict[str, Camera] = Field(
        default_factory=dict,
        description="calibration of the fixed cameras behind spaces in pixels, by name of the space: "
        "their hypotheses are linked to the bodies of a metric space",
    )

    def switch_for(self, unit: Unit) -> float:
        """Standard deviation where the affinity is 0.5, in `unit`."""
        return _SIGMA_SWITCH[unit] if self.sigma_switch is None else self.sigma_switch

    def v_move_for(self, unit: Unit) -> float | None:
        """Speed of (3.2)'s λ in `unit` per second, or None for equal weights."""
        return _V_MOVE[unit] if self.v_move == "auto" else self.v_move


def to_ns(seconds: float) -> int:
    """Seconds as whole nanoseconds."""
    return round(seconds * 1e9)
