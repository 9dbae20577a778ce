"""Every parameter of the fusion, nested by method, with unit, default and bounds.

Numbers that nobody has a reason to set are constants beside the code that uses them. Those of the pixel
method were chosen together on public sequences, as docs/research/pixels.md says.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from comotion_schemas.errors import KnownError

Clustering = Literal["divisive-kmeans", "gmm-bic", "eigengap", "eigengap-normalized"]
Unit = Literal["m", "px"]
Method = Literal["comotion", "thesis"]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Above = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, le=100_000)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
Share = Annotated[float, Field(gt=0, le=1)]
# s, up to a day.
Timeout = Annotated[float, Field(gt=0, le=86_400)]
# Bounded away from zero: its square must not vanish.
Bounded = Annotated[float, Field(ge=1e-9, le=1e9)]

_DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)  # of OpenCV's models


class Group(BaseModel):
    """A group of parameters: frozen, and without others."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ThesisConfig(Group):
    """Parameters of the method of the thesis."""

    sigma_switch: Bounded | None = Field(
        default=None,
        description="m or px; standard deviation of a distance where the affinity is 0.5; "
        "null: 0.02 m or 8 px",
    )
    v_move: Bounded | Literal["auto"] | None = Field(
        default="auto",
        description="m/s or px/s; speed at which a feature weighs 0.9; "
        "auto: 0.1 m/s or 20 px/s, null: equal weights",
    )
    stop_affinity: Annotated[float, Field(ge=0, lt=1)] = Field(
        default=0.4, description="a cluster is split while its smallest affinity is not above this"
    )
    clustering: Clustering = Field(default="divisive-kmeans", description="how the affinities are clustered")


class RigidConfig(Group):
    """Parameters of the rigid-motion method; none depends on the scale of the scene."""

    frame_rate: Annotated[float, Field(gt=0, le=200)] = Field(
        default=15.0, description="Hz; rate of the common frames that trajectories are interpolated to"
    )
    rigidity_motion: Above = Field(
        default=0.01, description="share; a body may deform by this share of a trajectory's rms displacement"
    )
    rigidity_extent: Above = Field(
        default=0.0015, description="share; ... but not by more than this of the scene"
    )
    rigidity_contact: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.25,
        description="share; ... and by no less than this of what the trajectories of the scene do, rms",
    )
    looseness: Annotated[float, Field(ge=0, le=10)] = Field(
        default=1.0, description="factor of the variance by which bodies deform; 0: they are rigid"
    )
    residual_cap: Above = Field(
        default=16.0,
        description="squared residual per dimension, in tolerances, from which on it costs no more",
    )
    outlier_share: float = Field(
        default=0.5, gt=0, le=1, description="share of the cap that a frame of an outlier costs"
    )
    birth_price: Above = Field(default=15.0, description="nat; price of a hypothesis beside its poses")
    membership_price: Annotated[float, Field(ge=0, le=100)] = Field(
        default=1.5,
        description="price of the memberships of a moving body, as a factor of the nats that it takes to say "
        "which trajectories they are",
    )
    prior_floor: Annotated[float, Field(ge=0, le=100)] = Field(
        default=6.0,
        description="nat; most that the spatial prior may cost (log density of each hypothesis' members)",
    )
    min_life: Annotated[float, Field(ge=0.1, le=10)] = Field(
        default=0.3,
        description="s of observation from which on a trajectory takes part in finding hypotheses",
    )


class PixelsConfig(Group):
    """Parameters of grouping in pixel space."""

    key_frames: int = Field(
        default=24, ge=2, le=1000, description="instants of the window that trajectories are compared at"
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


class HypothesesConfig(Group):
    """When a hypothesis is confirmed, and how long one without current members is remembered."""

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


class Camera(Group):
    """Calibration of the camera behind a space in pixels: a pinhole with OpenCV's distortion.

    x_frame = R x_camera + translation, R from the quaternion (x, y, z, w); optical axes: x right,
    y down, z forward. The camera does not move.
    """

    fx: Positive = Field(description="px; focal length")
    fy: Positive = Field(description="px; focal length")
    cx: Finite = Field(description="px; principal point")
    cy: Finite = Field(description="px; principal point")
    distortion: tuple[Finite, ...] = Field(default=(), description="k1, k2, p1, p2, k3 ... as in OpenCV")
    translation: tuple[Finite, Finite, Finite] = Field(description="m; where the camera is")
    quaternion: tuple[Finite, Finite, Finite, Finite] = Field(description="x, y, z, w; camera to frame")
    frame: str = Field(default="world", description="metric space that translation and quaternion lead to")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.distortion) not in _DISTORTION_LENGTHS:
            raise KnownError(f"{len(self.distortion)} distortion coefficients; OpenCV knows 4, 5, 8, 12, 14")
        if not 1e-9 < math.hypot(*self.quaternion) < 1e9:
            raise KnownError("the quaternion is zero or beyond measure")
        return self


class LinkingConfig(Group):
    """The cameras whose spaces are linked to a metric one."""

    cameras: dict[str, Camera] = Field(
        default_factory=dict,
        description="calibration of the fixed cameras behind spaces in pixels, by name of the space: "
        "their hypotheses are linked to the bodies of a metric space",
    )


class JointsConfig(Group):
    """How much time may be spent on joints."""

    pairs: Annotated[int, Field(ge=0, le=100)] = Field(
        1, description="pairs of hypotheses that are judged together, every 150 ms at most; 0: no joints"
    )


class LimitsConfig(Group):
    """Bounds of a scene, and of one source where that is said."""

    sources: int = Field(
        1024, ge=1, le=65_536, description="source names at a time; the one silent for longest goes"
    )
    spaces: int = Field(
        256, ge=1, le=4096, description="coordinate spaces at a time; one that nobody publishes goes"
    )
    instants: int = Field(1024, ge=1, le=100_000, description="different row stamps in one batch")
    waiting: float = Field(
        64.0, ge=1, le=4096, description="MB of batches of one source that wait for the watermark"
    )
    waiting_all: Annotated[float, Field(ge=1, le=65_536)] = Field(
        256.0, description="MB of batches of all sources that wait; beyond it, each source has its share"
    )
    waiting_batches: int = Field(
        4096, ge=1, le=1_000_000, description="batches of one source that wait for the watermark"
    )
    extent: Annotated[float, Field(ge=0, le=1e9)] = Field(
        200.0,
        description="rows so many times farther out than the other sources of the space see (at least 1 m or "
        "1000 px) are refused; 0: none",
    )
    expiry: Timeout = Field(
        60.0, description="s without data after which a source, and an empty space, is forgotten"
    )
    release: Timeout = Field(
        5.0, description="s without data after which a space may be published with another unit or dim"
    )
    processing: Share = Field(
        0.5, description="share of a period for taking in batches; each source has its share of that"
    )
    shedding: bool = Field(True, description="leave out searches when updates take longer than a period")
    queries: Share = Field(
        0.1, description="share of a period for answering queries; one a period is always answered"
    )


class SpaceConfig(Group):
    """What is known of a coordinate space; what is not, its first source says."""

    unit: Unit | None = Field(
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
    sources: tuple[str, ...] | None = Field(
        None, description="names of the sources that may publish in it, others are refused; null: all"
    )


class FusionConfig(Group):
    """Parameters of :class:`comotion.Fusion`; frozen, validated, dumpable."""

    method: Method = Field(default="comotion", description="how hypotheses are inferred")
    window: float = Field(
        default=10.0, gt=0, le=600, description="s; observations older than this leave the trajectories"
    )
    period: float = Field(default=0.1, ge=0.005, le=60, description="s between updates")
    allowed_lateness: Annotated[float, Field(ge=0, le=10)] = Field(
        default=0.2, description="s behind the watermark up to which an observation is still inserted"
    )
    max_lag: float = Field(
        default=0.5, ge=0, le=10, description="s the watermark may stay behind the clock for a slow source"
    )
    source_timeout: Annotated[float, Field(gt=0, le=60)] = Field(
        default=1.0, description="s without data after which a source no longer holds the watermark"
    )
    track_timeout: Annotated[float, Field(gt=0, le=60)] = Field(
        default=0.5,
        description="s without observation after which a trajectory is outdated (or 3 source periods)",
    )
    max_tracks: int = Field(
        default=5000, ge=1, le=100_000, description="trajectories kept at once; further ones are refused"
    )

    thesis: ThesisConfig = Field(
        default=ThesisConfig(), description="the method of the thesis, in spaces of either unit"
    )
    rigid: RigidConfig = Field(default=RigidConfig(), description="the default method in spaces of unit m")
    pixels: PixelsConfig = Field(
        default=PixelsConfig(), description="the default method in spaces of unit px"
    )
    hypotheses: HypothesesConfig = Field(
        default=HypothesesConfig(), description="confirmation and memory, for all methods"
    )
    linking: LinkingConfig = Field(
        default=LinkingConfig(), description="links between spaces in pixels and metric spaces"
    )

    joints: JointsConfig = Field(
        default=JointsConfig(), description="joints between the hypotheses of a metric space"
    )
    limits: LimitsConfig = Field(
        default=LimitsConfig(), description="bounds on what sources may make the service hold"
    )
    spaces: dict[str, SpaceConfig] = Field(
        default_factory=dict,
        description="what is known of single spaces, by name: `unit`, `dim`, `moving` for a carried camera, "
        "and `sources`, the names of those that may publish in it",
    )


def to_ns(seconds: float) -> int:
    """Seconds as whole nanoseconds."""
    return round(seconds * 1e9)
