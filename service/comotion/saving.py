"""In objects, out plain values and arrays that a snapshot keeps, and the other way round by their types.

What is kept are dataclasses and named tuples of numbers, texts, arrays, rigid motions and more of them, also
in dicts, lists, tuples, sets and queues. Fields that are marked with :data:`NOT_KEPT` come from elsewhere.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from scipy.spatial.transform import RigidTransform

NOT_KEPT = {"kept": False}
"""Metadata of a field that a snapshot does not keep."""
_UNIONS = (Union, UnionType)
_ATOMS = frozenset((int, str, float, bool, NoneType))


def plain(one: Any) -> Any:
    """A copy as plain values and arrays: nothing else changes it; of a dict with its items as a list."""
    kind: Any = type(one)
    found = one
    if kind in _ATOMS:
        pass
    elif is_dataclass(one):
        found = {name: plain(getattr(one, name)) for name in _kept(kind)}
    elif isinstance(one, np.ndarray):
        found = one.copy()
    elif isinstance(one, RigidTransform):
        found = one.as_matrix()
    elif isinstance(one, Mapping):
        found = [[plain(key), plain(value)] for key, value in one.items()]
    elif isinstance(one, list | tuple | set | deque):
        found = [plain(member) for member in one]
    return found


def restored(kind: Any, state: Any) -> Any:
    """What :func:`plain` was given, by its type.

    Raises
    ------
    AttributeError, KeyError, TypeError, ValueError
        If `state` is not of this type, as far as that shows.
    """
    origin: Any = get_origin(kind) or kind
    members = [member for member in get_args(kind) if member is not NoneType]
    found = state
    if state is None or (origin in _UNIONS and len(members) > 1):
        # Of several kinds of numbers the state says which one it is.
        pass
    elif origin is RigidTransform:
        found = RigidTransform.from_matrix(state)
    elif origin in _UNIONS:
        found = restored(members[0], state)
    elif is_dataclass(origin):
        types = _types(kind)
        found = kind(**{name: restored(types[name], value) for name, value in state.items()})
    elif hasattr(origin, "_fields"):
        found = kind(*map(restored, _types(kind).values(), state))
    elif origin is dict:
        found = {restored(members[0], key): restored(members[1], value) for key, value in state}
    elif origin is tuple and members[-1] is not Ellipsis:
        found = tuple(map(restored, members, state))
    elif origin in (list, tuple, set, deque):
        found = origin(restored(members[0], member) for member in state)
    return found


def refill(one: Any, state: Mapping[str, Any]) -> None:
    """Give a dataclass the fields that :func:`plain` has kept of its like."""
    kind: Any = type(one)
    types = _types(kind)
    for name in _kept(kind):
        setattr(one, name, restored(types[name], state[name]))


@cache
def _kept(kind: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind) if field.metadata.get("kept", True))


@cache
def _types(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)
