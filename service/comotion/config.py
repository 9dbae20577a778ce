"""Every parameter of the fusion, nested by method, with unit, default and bounds; reads them from people.

Numbers that nobody has a reason to set are constants beside the code that uses them.
"""

import math
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from comotion_schemas.errors import KnownError

Clustering = Literal["divisive-kmeans", "gmm-bic", "eigengap", "eigengap-normalized"]
Unit = Literal["m", "px"]
Method = Literal["comotion", "thesis"]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Above = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
# Bounded away from zero: its square must not vanish.
Bounded = Annotated[float, Field(ge=1e-9, le=1e9)]

_DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)  # of OpenCV's models


class Group(BaseModel):
    """A group of parameters: frozen, and without others. The text below a parameter is its description."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class ThesisConfig(Group):
    """Parameters of the method of the thesis."""

    sigma_switch: Bounded | None = None
    """m or px; standard deviation of a distance where the affinity is 0.5; null: 0.02 m or 8 px"""
    v_move: Bounded | Literal["auto"] | None = "auto"
    """m/s or px/s; speed at which a feature weighs 0.9; auto: 0.1 m/s or 20 px/s, null: equal weights"""
    stop_affinity: Annotated[float, Field(ge=0, lt=1)] = 0.4
    """a cluster is split while its smallest affinity is not above this"""
    clustering: Clustering = "divisive-kmeans"
    """how the affinities are clustered"""


class RigidConfig(Group):
    """Parameters of the rigid-motion method; none depends on the scale of the scene."""

    frame_rate: Annotated[float, Field(gt=0, le=200)] = 15.0
    """Hz; rate of the common frames that trajectories are interpolated to"""
    looseness: Annotated[float, Field(ge=0, le=10)] = 1.0
    """factor of the variance by which bodies deform; 0: they are rigid"""
    birth_price: Above = 15.0
    """nat; price of a hypothesis beside its poses"""
    min_life: Annotated[float, Field(ge=0.1, le=10)] = 0.3
    """s of observation from which on a trajectory takes part in finding hypotheses"""


class HypothesesConfig(Group):
    """When a hypothesis is confirmed, and how long one without current members is remembered."""

    confirm: Annotated[float, Field(ge=0, le=60)] = 0.5
    """s that a hypothesis, a loss or a return must last until it makes an event"""
    memory: Annotated[float, Field(ge=0, le=86_400)] = 60.0
    """s for which a hypothesis without current members is remembered"""


class Camera(Group):
    """Calibration of the camera behind a space in pixels: a pinhole with OpenCV's distortion.

    x_frame = R x_camera + translation, R from the quaternion (x, y, z, w); optical axes: x right,
    y down, z forward. The camera does not move.
    """

    fx: Positive
    """px; focal length"""
    fy: Positive
    """px; focal length"""
    cx: Finite
    """px; principal point"""
    cy: Finite
    """px; principal point"""
    distortion: tuple[Finite, ...] = ()
    """k1, k2, p1, p2, k3 ... as in OpenCV"""
    translation: tuple[Finite, Finite, Finite]
    """m; where the camera is"""
    quaternion: tuple[Finite, Finite, Finite, Finite]
    """x, y, z, w; camera to frame"""
    frame: str = "world"
    """metric space that translation and quaternion lead to"""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.distortion) not in _DISTORTION_LENGTHS:
            raise KnownError(f"{len(self.distortion)} distortion coefficients; OpenCV knows 4, 5, 8, 12, 14")
        if not 1e-9 < math.hypot(*self.quaternion) < 1e9:
            raise KnownError("the quaternion is zero or beyond measure")
        return self


class LinkingConfig(Group):
    """The cameras whose spaces are linked to a metric one."""

    cameras: dict[str, Camera] = Field(default_factory=dict)
    """calibration of the fixed cameras behind spaces in pixels, by name of the space: their hypotheses are
    linked to the bodies of a metric space"""


class JointsConfig(Group):
    """How much time may be spent on joints."""

    pairs: Annotated[int, Field(ge=0, le=100)] = 1
    """pairs of hypotheses that are judged together, every 150 ms at most; 0: no joints"""


class LimitsConfig(Group):
    """Bounds of a scene."""

    extent: Annotated[float, Field(ge=0, le=1e9)] = 200.0
    """rows so many times farther out than the other sources of the space see (at least 1 m or 1000 px) are
    refused; 0: none"""
    expiry: Annotated[float, Field(gt=0, le=86_400)] = 60.0
    """s without data after which a source, and an empty space, is forgotten"""
    shedding: bool = True
    """leave out searches when updates take longer than a period"""


class SpaceConfig(Group):
    """What is known of a coordinate space; what is not, its first source says."""

    unit: Unit | None = None
    """m or px; batches of another unit are refused; null: that of the first source"""
    dim: Annotated[int, Field(ge=2, le=3)] | None = None
    """coordinates; batches of another number are refused; null: that of the first source"""
    moving: bool | None = None
    """its frame is carried, as that of a camera in the hand: the largest body is the world, and what is
    published is relative to it; null: if all its sources say so"""
    sources: tuple[str, ...] | None = None
    """names of the sources that may publish in it, others are refused; null: all"""


class FusionConfig(Group):
    """Parameters of :class:`comotion.Fusion`; frozen, validated, dumpable."""

    method: Method = "comotion"
    """how hypotheses are inferred"""
    window: Annotated[float, Field(gt=0, le=600)] = 10.0
    """s; observations older than this leave the trajectories"""
    period: Annotated[float, Field(ge=0.005, le=60)] = 0.1
    """s between updates"""
    allowed_lateness: Annotated[float, Field(ge=0, le=10)] = 0.2
    """s behind the watermark up to which an observation is still inserted"""
    max_lag: Annotated[float, Field(ge=0, le=10)] = 0.5
    """s the watermark may stay behind the clock for a slow source"""
    source_timeout: Annotated[float, Field(gt=0, le=60)] = 1.0
    """s without data after which a source no longer holds the watermark"""
    track_timeout: Annotated[float, Field(gt=0, le=60)] = 0.5
    """s without observation after which a trajectory is outdated (or 3 source periods)"""
    max_tracks: Annotated[int, Field(ge=1, le=100_000)] = 5000
    """trajectories kept at once; further ones are refused"""

    thesis: ThesisConfig = ThesisConfig()
    """the method of the thesis, in spaces of either unit"""
    rigid: RigidConfig = RigidConfig()
    """the default method in spaces of unit m"""
    hypotheses: HypothesesConfig = HypothesesConfig()
    """confirmation and memory, for all methods"""
    linking: LinkingConfig = LinkingConfig()
    """links between spaces in pixels and metric spaces"""

    joints: JointsConfig = JointsConfig()
    """joints between the hypotheses of a metric space"""
    limits: LimitsConfig = LimitsConfig()
    """bounds on what sources may make the service hold"""
    spaces: dict[str, SpaceConfig] = Field(default_factory=dict)
    """what is known of single spaces, by name: `unit`, `dim`, `moving` for a carried camera, and `sources`,
    the names of those that may publish in it"""


def to_ns(seconds: float) -> int:
    """Seconds as whole nanoseconds."""
    return round(seconds * 1e9)


def read_config(values: Mapping[str, Any]) -> FusionConfig:
    """Build the parameters from names and values; those of a group nested, or as ``group.name``.

    Raises ValueError for an unknown name, with the one that is most like it, or a value out of bounds.
    """
    nested = {name: value for name, value in values.items() if "." not in name}
    for name in values.keys() - nested.keys():
        put(nested, name, values[name])
    try:
        return FusionConfig(**nested)
    except ValidationError as error:
        raise KnownError(_describe(error)) from None


def put(values: dict[str, Any], name: str, value: Any) -> None:
    """Set a parameter; ``group.name`` is one of a group, ``linking.cameras.NAME`` one camera."""
    *groups, last = name.split(".", 2)
    for group in groups:
        members = values.get(group)
        values[group] = dict(members) if isinstance(members, Mapping) else {}
        values = values[group]
    values[last] = value


def _describe(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    # What comes after a parameter's name is pydantic's; only cameras have names and members.
    depth = 4 if first["loc"][:1] == ("linking",) else 2
    name = ".".join(str(part) for part in first["loc"][:depth])
    if first["type"] == "extra_forbidden":
        return f"unknown fusion parameter {name!r}; {_suggestion(name)}"
    message = first["msg"].removeprefix("Value error, ")
    return f"fusion parameter {name}: {message}, got {first['input']!r}" if name else message


def _suggestion(name: str) -> str:
    """The parameter most like a misspelt one, of its group or of any."""
    group, _, last = name.rpartition(".")
    names = sorted(_parameter_names(FusionConfig), key=lambda full: full.rpartition(".")[0] == group)
    short = {full.rpartition(".")[2]: full for full in names}
    likely = get_close_matches(last, short, 1)
    return f"did you mean {short[likely[0]]}?" if likely else "see 'comotion config'"


def _parameter_names(model: type[BaseModel]) -> Iterator[str]:
    """Names of a model's parameters, those of a group as ``group.name``."""
    for name, field in model.model_fields.items():
        members = getattr(field.annotation, "model_fields", ())
        yield from (f"{name}.{member}" for member in members) if members else (name,)
