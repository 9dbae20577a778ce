"""Names that parameters had before they were grouped by method -> the nested names."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from comotion_schemas.errors import KnownError

MEMBERS = {
    "sigma_switch": "thesis",
    "v_move": "thesis",
    "stop_affinity": "thesis",
    "clustering": "thesis",
    "cameras": "linking",
}
"""Group of each parameter that once stood at the top."""

GROUPS = {"motion": "rigid"}
"""Present name of each group that was renamed."""


def present_name(name: str) -> str:
    """Present name of a parameter: ``motion.stay`` is ``rigid.stay``, ``v_move`` is ``thesis.v_move``."""
    first, dot, rest = name.partition(".")
    first = f"{MEMBERS[first]}.{first}" if first in MEMBERS else GROUPS.get(first, first)
    return first + dot + rest


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters by their present names, of parameters by present or flat names.

    Raises
    ------
    ValueError
        If one parameter is given by both names.
    """
    found = {name: value for name, value in values.items() if name not in MEMBERS and name not in GROUPS}
    for old in values.keys() & GROUPS.keys():
        if GROUPS[old] in found:
            raise KnownError(f"{old} and {GROUPS[old]} are the same group; give one of them")
        found[GROUPS[old]] = values[old]
    for name in values.keys() & MEMBERS.keys():
        group = _as_dict(found.get(MEMBERS[name], {}))
        if name in group:
            raise KnownError(f"{name} and {MEMBERS[name]}.{name} are the same parameter; give one of them")
        found[MEMBERS[name]] = {**group, name: values[name]}
    return found


def _as_dict(group: Any) -> dict[str, Any]:
    """What a group was given explicitly."""
    if isinstance(group, BaseModel):
        return {name: getattr(group, name) for name in group.model_fields_set}
    if not isinstance(group, Mapping):
        raise KnownError(f"expected parameters by name, got {group!r}")
    return dict(group)
