"""Checks the description of a simulated scene that a TOML file gives.

Lengths are in the unit of the scene, angles in rad, times in seconds. The package contains scenes in
``comotion_sources/scenes``.
"""

from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from comotion_schemas.errors import InputError, KnownError, describe

from ..bounded import parse_toml, read_text

_MAX_BYTES = 1_000_000
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Rate = Annotated[float, Field(gt=0, le=1000)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Range(_Part):
    """A value drawn uniformly between two bounds, independently for each axis."""

    min: NotNegative
    max: Positive

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min > self.max:
            raise KnownError("min exceeds max")
        return self


class Rest(_Part):
    """A body at rest: at the position `at`, or drawn within ±`within` of the origin per axis."""

    kind: Literal["rest"] = "rest"
    at: list[Finite] | None = None
    within: NotNegative = 0.0


class KeyStates(_Part):
    """Linear interpolation between states (t, position..., rotation...).

    The rotation is an angle in 2-D and a rotation vector in 3-D, rad. Before the first state and after
    the last one the body is at rest.
    """

    kind: Literal["key-states"]
    states: Annotated[list[list[Finite]], Field(min_length=1)]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        times = [state[0] for state in self.states if state]
        if len(times) != len(self.states) or any(a >= b for a, b in pairwise(times)):
            raise KnownError("the times of the states must increase")
        return self


class Sines(_Part):
    """Sum of two sines per axis about a place, for position and rotation.

    Frequencies are drawn from `frequency` (Hz), phases uniformly. Each of the two amplitudes is half
    of `amplitude` (`rotation` in rad), times a factor drawn from 0.7 to 1.3. Before `start` the body
    is at rest at the start of its motion.
    """

    kind: Literal["sines"]
    at: list[Finite] | None = None
    within: NotNegative = 0.0
    amplitude: NotNegative
    rotation: NotNegative = 0.0
    frequency: Range = Range(min=0.05, max=0.2)
    start: NotNegative = 0.0


Motion = Annotated[Rest | KeyStates | Sines, Field(discriminator="kind")]


class Body(_Part):
    """A rigid body: features drawn uniformly in a rectangle or box about its origin."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    object: Annotated[str, Field(min_length=1, max_length=64)] | None = Field(
        default=None,
        description="name of the true object, for bodies that are one object. Default: the body's name",
    )
    features: Annotated[int, Field(ge=0, le=100_000)]
    poses: Annotated[int, Field(ge=0, le=1000)] = Field(
        default=0, description="additional 6-DoF features (3-D)"
    )
    size: list[Positive] | Range
    sigma: NotNegative = Field(description="noise of an observation, one sigma per axis")
    pose_sigma: NotNegative = Field(
        default=0.01, description="rad; noise of an observed orientation, per axis"
    )
    motion: Motion = Rest()


class Respawn(_Part):
    """Every `every` seconds a random `share` of the features of each body ends and is replaced."""

    every: Positive
    share: Share


class Gaps(_Part):
    """Occlusion: a `share` of the features is unobserved once for `shortest` to `longest` seconds."""

    share: Share
    shortest: NotNegative
    longest: Positive


class Outliers(_Part):
    """Features with independent motion, each a separate object: `share` of the number of all others."""

    share: Share
    sigma: NotNegative
    motion: Sines


class SceneSpec(_Part):
    """One simulated scene.

    Attributes
    ----------
    title
        One line for lists.
    dim, unit, space
        Coordinate space of the observations. By default its name is ``world`` in 3-D and ``plane`` in
        2-D, because within a service one name has one dimension.
    duration
        Length in seconds.
    rate
        Frames per second of a single source.
    sources
        Frames per second of each source, for a scene with several sources.
    bodies, respawn, gaps, outliers
        Content of the scene.
    camera
        Motion of the frame of the observations; None: the world frame.
    """

    title: Annotated[str, Field(min_length=1, max_length=200)]
    dim: Literal[2, 3]
    unit: Literal["m", "px"] = "m"
    space: Annotated[str, Field(min_length=1, max_length=256)] = Field(
        default_factory=lambda fields: "plane" if fields.get("dim") == 2 else "world"
    )
    duration: Annotated[float, Field(gt=0, le=86_400)]
    rate: Rate = 15.0
    sources: Annotated[list[Rate], Field(min_length=1, max_length=64)] | None = None
    bodies: Annotated[list[Body], Field(min_length=1)]
    respawn: Respawn | None = None
    gaps: Gaps | None = None
    outliers: Outliers | None = None
    camera: Sines | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for body in self.bodies:
            if isinstance(body.size, list) and len(body.size) != self.dim:
                raise KnownError(f"body {body.name!r}: size needs {self.dim} numbers")
            if body.poses and self.dim != 3:
                raise KnownError(f"body {body.name!r}: poses need dim 3")
            _check_motion(f"body {body.name!r}", body.motion, self.dim)
        if self.camera is not None:
            _check_motion("camera", self.camera, self.dim)
        if self.outliers is not None:
            _check_motion("outliers", self.outliers.motion, self.dim)
        if len({body.name for body in self.bodies}) != len(self.bodies):
            raise KnownError("two bodies have the same name")
        return self

    @property
    def rates(self) -> list[float]:
        """Frames per second of each source."""
        return list(self.sources or [self.rate])

    @property
    def object_names(self) -> list[str]:
        """Names of the true objects of the bodies; an object's number is its index."""
        return list(dict.fromkeys(body.object or body.name for body in self.bodies))


def _check_motion(what: str, motion: Rest | KeyStates | Sines, dim: int) -> None:
    if isinstance(motion, KeyStates):
        width = 1 + dim + (1 if dim == 2 else 3)
        if any(len(state) != width for state in motion.states):
            raise KnownError(f"{what}: a state needs {width} numbers: t, position, rotation")
    elif motion.at is not None and len(motion.at) != dim:
        raise KnownError(f"{what}: at needs {dim} numbers")


_SHIPPED = Path(str(resources.files("comotion_sources") / "scenes"))


def scene_names() -> list[str]:
    """List the names of the scenes in the package, sorted."""
    return sorted(path.stem for path in _SHIPPED.glob("*.toml"))


def load_scene(scene: str | Path) -> SceneSpec:
    """Load a scene: the name of one in the package, or the path of a TOML file.

    Raises
    ------
    InputError
        If the scene does not exist or is malformed; the message is one line.
    """
    path = _SHIPPED / f"{scene}.toml" if str(scene) in scene_names() else Path(scene)
    if not path.is_file():
        raise InputError(f"no scene {str(scene)!r}: neither a file nor one of {', '.join(scene_names())}")
    text = read_text(path, _MAX_BYTES)
    try:
        return SceneSpec.model_validate(parse_toml(text))
    except ValidationError as error:
        raise InputError(f"scene {scene}: {describe(error)}") from None
    except ValueError as error:
        raise InputError(f"scene {scene}: not valid TOML: {' '.join(str(error).split())}") from None
