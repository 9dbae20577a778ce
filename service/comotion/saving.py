"""Turns objects into plain values and arrays that a snapshot keeps, and restores them by their types.

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


def plain(original: Any) -> Any:
    """Copy a value to plain values and arrays that share nothing with it; a dict becomes a list of items."""
    kind: Any = type(original)
    copied = original
    if kind in _ATOMS:
        pass
    elif is_dataclass(original):
        copied = {name: plain(getattr(original, name)) for name in _kept(kind)}
    elif isinstance(original, np.ndarray):
        copied = original.copy()
    elif isinstance(original, RigidTransform):
        copied = original.as_matrix()
    elif isinstance(original, Mapping):
        copied = [[plain(key), plain(value)] for key, value in original.items()]
    elif isinstance(original, list | tuple | set | deque):
        copied = [plain(member) for member in original]
    return copied


def restored(kind: Any, state: Any) -> Any:
    """Restore from `state` the value that :func:`plain` was given, by its type.

    Raises
    ------
    AttributeError, KeyError, TypeError, ValueError
        If `state` is not of this type, as far as that shows.
    """
    origin: Any = get_origin(kind) or kind
    members = [member for member in get_args(kind) if member is not NoneType]
    rebuilt = state
    if state is None or (origin in _UNIONS and len(members) > 1):
        # A union of several types of numbers: the state has the right one already.
        pass
    elif origin is RigidTransform:
        rebuilt = RigidTransform.from_matrix(state)
    elif origin in _UNIONS:
        rebuilt = restored(members[0], state)
    elif is_dataclass(origin):
        types = _types(kind)
        rebuilt = kind(**{name: restored(types[name], value) for name, value in state.items()})
    elif hasattr(origin, "_fields"):
        rebuilt = kind(*map(restored, _types(kind).values(), state))
    elif origin is dict:
        rebuilt = {restored(members[0], key): restored(members[1], value) for key, value in state}
    elif origin is tuple and members[-1] is not Ellipsis:
        rebuilt = tuple(map(restored, members, state))
    elif origin in (list, tuple, set, deque):
        rebuilt = origin(restored(members[0], member) for member in state)
    return rebuilt


def refill(target: Any, state: Mapping[str, Any]) -> None:
    """Set the fields of a dataclass to those that :func:`plain` has kept of one of its type.

    A field that is a dataclass with fields that are not kept is refilled in turn.
    """
    kind: Any = type(target)
    types = _types(kind)
    for name in _kept(kind):
        member: Any = type(getattr(target, name))
        if hasattr(member, "__dataclass_fields__") and len(_kept(member)) < len(fields(member)):
            refill(getattr(target, name), state[name])
        else:
            setattr(target, name, restored(types[name], state[name]))


@cache
def _kept(kind: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind) if field.metadata.get("kept", True))


@cache
def _types(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)
