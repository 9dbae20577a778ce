"""Turns objects into plain values and arrays, these into checked bytes, and both back.

What is kept are dataclasses and named tuples of numbers, texts, arrays, rigid motions and more of them, also
in dicts, lists, tuples, sets and queues. Fields that are marked with :data:`NOT_KEPT` come from elsewhere.

The bytes of a snapshot are no pickle: a state file is data from outside, and reading it must not run code.
The layout is

    header      magic, format, bytes of the values, digest of all that follows
    values      msgpack, with a reference in the place of each array
    arrays      their bytes, one after the other
"""

import hashlib
import struct
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import msgpack
import numpy as np
from scipy.spatial.transform import RigidTransform

from comotion_schemas.errors import KnownError

NOT_KEPT = {"kept": False}
"""Metadata of a field that a snapshot does not keep."""
_UNIONS = (Union, UnionType)
_ATOMS = frozenset((int, str, float, bool, NoneType))
FORMAT = 16
"""Version of the layout and of the state in it."""
MAX_BYTES = 1 << 30
_MAGIC = b"comotion"
_HEADER = struct.Struct("<8sIQ16s")
_ARRAY = "__array__"
_SAFE_KINDS = "biuf"
_DIGEST_BYTES = 16
Built = TypeVar("Built")


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
    elif isinstance(original, set):
        # In an order that does not depend on the process.
        copied = [plain(member) for member in sorted(original)]
    elif isinstance(original, list | tuple | deque):
        copied = [plain(member) for member in original]
    return copied


def restored(kind: Any, state: Any) -> Any:
    """Restore from `state` the value that :func:`plain` was given, by its type.

    Raises AttributeError, KeyError, TypeError or ValueError if `state` is not of it, as far as that shows.
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


def pieces(state: dict[str, Any]) -> list[Any]:
    """Serialise nested dicts and lists of plain values and numeric arrays, without a copy of the arrays.

    Returns buffers that make up the snapshot, in order; raises TypeError for anything else in `state`.
    """
    parts: list[memoryview] = []
    size = 0

    def refer(value: Any) -> Any:
        """Put an array behind the others; returns a reference to it for its place."""
        nonlocal size
        if isinstance(value, np.ndarray) and value.dtype.kind in _SAFE_KINDS:
            parts.append(np.ascontiguousarray(value).reshape(-1).view(np.uint8).data)
            size += parts[-1].nbytes
            return {_ARRAY: [value.dtype.str, list(value.shape), size - parts[-1].nbytes]}
        if isinstance(value, np.generic):
            return value.item()
        raise TypeError(f"cannot store a {type(value).__name__}")

    values = cast("bytes", msgpack.packb(state, default=refer))
    return [_HEADER.pack(_MAGIC, FORMAT, len(values), _digest([values, *parts])), values, *parts]


def load(data: bytes, build: Callable[[dict[str, Any]], Built]) -> Built:
    """Return what `build` makes of the state in `data`; its arrays are writeable.

    Raises ValueError if `data` is no snapshot of this version, or damaged, or `build` fails.
    """
    if not data.startswith(_MAGIC):
        raise KnownError("not a snapshot")
    if len(data) < _HEADER.size:
        raise KnownError("damaged snapshot: it ends within its header")
    _, version, size, digest = _HEADER.unpack_from(data)
    if version != FORMAT:
        raise KnownError(f"not a snapshot of this version: format {version}, expected {FORMAT}")
    body = memoryview(data)[_HEADER.size :]
    if _digest([body]) != digest:
        raise KnownError("damaged snapshot: its checksum is wrong")
    try:
        state = msgpack.unpackb(
            body[:size],
            raw=False,
            strict_map_key=False,
            object_hook=lambda value: _resolve(value, body[size:]),
        )
        return build(state)
    # Whatever goes wrong in a state that is checked but does not fit, the state is to blame.
    except Exception as error:
        raise KnownError(f"damaged snapshot: {type(error).__name__} {error}") from error


def _digest(parts: Iterable[Any]) -> bytes:
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for part in parts:
        digest.update(part)
    return digest.digest()


def _resolve(value: dict[Any, Any], arrays: memoryview) -> Any:
    if _ARRAY not in value:
        return value
    dtype, shape, at = value[_ARRAY]
    kind = np.dtype(dtype)
    if kind.kind not in _SAFE_KINDS:
        raise KnownError("not a numeric array")
    count = int(np.prod(shape, dtype=object))
    return np.frombuffer(arrays, kind, count, at).reshape(shape).copy() if count else np.empty(shape, kind)
