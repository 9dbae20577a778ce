"""The parameters of the fusion, and how people write them; one error names what is wrong."""

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, ValidationError

from comotion_schemas.errors import KnownError

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


def read_config(values: Mapping[str, Any]) -> FusionConfig:
    """Build the parameters from names and values; those of a group nested, or as ``group.name``.

    Raises
    ------
    ValueError
        For an unknown name, with the one that is most like it, or a value out of bounds.
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
        before = values.get(group)
        values[group] = dict(before) if isinstance(before, Mapping) else {}
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
    known = sorted(_parameter_names(FusionConfig), key=lambda full: full.rpartition(".")[0] == group)
    short = {full.rpartition(".")[2]: full for full in known}
    found = get_close_matches(last, short, 1)
    return f"did you mean {short[found[0]]}?" if found else "see 'comotion config'"


def _parameter_names(model: type[BaseModel]) -> Iterator[str]:
    """Names of a model's parameters, those of a group as ``group.name``."""
    for name, field in model.model_fields.items():
        members = getattr(field.annotation, "model_fields", ())
        yield from (f"{name}.{member}" for member in members) if members else (name,)
