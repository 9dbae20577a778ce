"""Checks the arguments of callers: parameters, trajectories and their times."""

import warnings
from collections.abc import Mapping
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from comotion_schemas.doubts import doubts, too_seldom
from comotion_schemas.errors import KnownError
from comotion_schemas.rows import check_space
from comotion_schemas.time_units import LONGEST_STEP_S, seconds
from comotion_schemas.types import Unit

from ..arrays import Floats
from ..config import FusionConfig, Method, read_config

DEFAULT = "default"
# Instants that a trajectory should have in the window.
_LEAST_INSTANTS = 5


class Parameters(TypedDict, total=False):
    """Parameters of the fusion by name, as in :class:`comotion.FusionConfig`; a group is a dict."""

    method: Method
    window: float
    period: float
    allowed_lateness: float
    max_lag: float
    source_timeout: float
    track_timeout: float
    max_tracks: int
    thesis: Mapping[str, Any]
    rigid: Mapping[str, Any]
    hypotheses: Mapping[str, Any]
    linking: Mapping[str, Any]
    joints: Mapping[str, Any]
    limits: Mapping[str, Any]
    spaces: Mapping[str, Any]


def config_of(config: FusionConfig | Mapping[str, Any] | None, parameters: Parameters) -> FusionConfig:
    """The parameters of a call: a configuration or a dict, and what keywords change in it."""
    if isinstance(config, FusionConfig):
        return read_config({**dict(config), **parameters}) if parameters else config
    if config is None or isinstance(config, Mapping):
        return read_config({**(config or {}), **parameters})
    raise KnownError(f"config is {type(config).__name__}, not a FusionConfig or a dict of parameters")


def longest_step_s(config: FusionConfig) -> float:
    """Time between two instants, s, above which a window holds too few to see motion."""
    return max(LONGEST_STEP_S, config.window / _LEAST_INSTANTS)


def unit_of(unit: str | None, dims: set[int]) -> Unit:
    """The unit of all sources, whose `dims` must not differ: the given one, or m for 3-D and px for 2-D."""
    if len(dims) != 1:
        raise KnownError(f"sources differ in their number of coordinates: {sorted(dims)}")
    (dim,) = dims
    chosen = unit or ("m" if dim == 3 else "px")
    check_space(chosen, dim)
    return "m" if chosen == "m" else "px"


def checked(name: str, positions: ArrayLike, times: ArrayLike, step_s: float) -> tuple[Floats, Floats]:
    """Positions float64 [T, N, dim] of one source, rows of NaN where unseen, and times float64 [T] in s."""
    try:
        return _checked(positions, times, step_s)
    except KnownError as error:
        raise KnownError(str(error) if name == DEFAULT else f"source {name!r}: {error}") from None


def _checked(positions: ArrayLike, times: ArrayLike, step_s: float) -> tuple[Floats, Floats]:
    try:
        states = np.array(positions, np.float64)
    except (TypeError, ValueError):
        raise KnownError("positions are no array of numbers [T, N, 3] or [T, N, 2]") from None
    if states.ndim != 3 or states.shape[2] not in {2, 3}:
        raise KnownError(f"positions have the shape {states.shape}, not [T, N, 3] or [T, N, 2]")
    shape = np.shape(times)
    if shape != states.shape[:1]:
        raise KnownError(f"there are {shape} times for {len(states)} instants")
    clock = seconds(times, longest_step_s=step_s)
    if (np.abs(states) > np.finfo(np.float32).max).any():
        raise KnownError("a position is infinite; NaN stands for unseen")
    states[np.isnan(states).any(axis=2)] = np.nan
    if not np.isfinite(states).any():
        raise KnownError("there is no observation")
    return states, clock


def common_origin(clocks: Mapping[str, Floats]) -> float:
    """The first time of all sources, s: they overlap or follow each other within a day, by one clock."""
    spans = sorted((float(clock[0]), float(clock[-1]), name) for name, clock in clocks.items())
    end, last = spans[0][1], spans[0][2]
    for first, final, name in spans:
        if first - end > 86_400.0:
            raise KnownError(
                f"times of {name!r} begin {(first - end) / 86_400:.3g} days after those of {last!r} end; "
                "sources share one clock"
            )
        if final > end:
            end, last = final, name
    return spans[0][0]


def say_doubts(
    arrays: Mapping[str, Floats], clocks: Mapping[str, Floats], unit: Unit, timeout_s: float
) -> None:
    """Warn about what is probably wrong with the data of each source; a track ends after `timeout_s`."""
    for name, states in arrays.items():
        steps = np.diff(clocks[name])
        seldom = too_seldom(float(np.median(steps)), timeout_s, unit) if len(steps) else None
        for text in [*doubts(states, unit), *([seldom] if seldom else [])]:
            warnings.warn(text if name == DEFAULT else f"source {name!r}: {text}", stacklevel=4)
