"""The groups of parameters: those of each method, and those that all share.

Numbers that nobody has a reason to set are constants beside the code that uses them. Those of the pixel
method were chosen together on public sequences, as docs/research/pixels.md says.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from comotion_schemas.errors import KnownError

Clustering = Literal["divisive-kmeans", "gmm-bic", "eigengap", "eigengap-normalized"]
Unit = Literal["m", "px"]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Above = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, le=100_000)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
# Bounded away from zero: its square must not vanish.
Bounded = Annotated[float, Field(ge=1e-9, le=1e9)]

_DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)  # of OpenCV's models
# What "null" and "auto" stand for, by unit of the space.
_SIGMA_SWITCH: dict[Unit, float] = {"m": 0.02, "px": 8.0}
_V_MOVE: dict[Unit, float] = {"m": 0.1, "px": 20.0}


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

    def switch_for(self, unit: Unit) -> float:
        """Standard deviation where the affinity is 0.5, in `unit`."""
        return _SIGMA_SWITCH[unit] if self.sigma_switch is None else self.sigma_switch

    def v_move_for(self, unit: Unit) -> float | None:
        """Speed of (3.2)'s λ in `unit` per second, or None for equal weights."""
        return _V_MOVE[unit] if self.v_move == "auto" else self.v_move


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
    outlier_share: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.5, description="share of the cap that a frame of an outlier costs"
    )
    pose_price: Above = Field(
        default=1.0,
        description="half nats that a degree of freedom of a pose must gain beyond the noise it fits",
    )
    birth_price: Above = Field(default=15.0, description="nat; price of a hypothesis beside its poses")
    membership_price: Annotated[float, Field(ge=0, le=100)] = Field(
        default=1.5,
        description="price of the memberships of a moving body, as a factor of the nats that it takes to say "
        "which trajectories they are",
    )
    stay: Annotated[float, Field(ge=0, le=100)] = Field(
        default=2.0, description="nat; preference of a trajectory for its hypothesis"
    )
    prior_weight: Annotated[float, Field(ge=0, le=10)] = Field(
        default=1.0, description="weight of the spatial prior (log density of each hypothesis' members)"
    )
    prior_floor: Above = Field(default=6.0, description="nat; most that the spatial prior may cost")
    min_life: Annotated[float, Field(ge=0.1, le=10)] = Field(
        default=0.3,
        description="s of observation from which on a trajectory takes part in finding hypotheses",
    )


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

    sources: Annotated[int, Field(ge=1, le=65_536)] = Field(
        1024, description="source names at a time; the one silent for longest goes"
    )
    spaces: Annotated[int, Field(ge=1, le=4096)] = Field(
        256, description="coordinate spaces at a time; one that nobody publishes goes"
    )
    instants: Annotated[int, Field(ge=1, le=100_000)] = Field(
        1024, description="different row stamps in one batch"
    )
    waiting: Annotated[float, Field(ge=1, le=4096)] = Field(
        64.0, description="MB of batches of one source that wait for the watermark"
    )
    waiting_all: Annotated[float, Field(ge=1, le=65_536)] = Field(
        256.0, description="MB of batches of all sources that wait; beyond it, each source has its share"
    )
    waiting_batches: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        4096, description="batches of one source that wait for the watermark"
    )
    extent: Annotated[float, Field(ge=0, le=1e9)] = Field(
        200.0,
        description="rows so many times farther out than the other sources of the space see (at least 1 m or "
        "1000 px) are refused; 0: none",
    )
    expiry: Annotated[float, Field(gt=0, le=86_400)] = Field(
        60.0, description="s without data after which a source, and an empty space, is forgotten"
    )
    release: Annotated[float, Field(gt=0, le=86_400)] = Field(
        5.0, description="s without data after which a space may be published with another unit or dim"
    )
    processing: Annotated[float, Field(gt=0, le=1)] = Field(
        0.5, description="share of a period for taking in batches; each source has its share of that"
    )
    shedding: bool = Field(
        default=True, description="leave out searches when updates take longer than a period"
    )
    queries: Annotated[float, Field(gt=0, le=1)] = Field(
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
