"""Serialises the state of a fusion as checked bytes, and reads it back.

Not pickle: a state file is data from outside, and reading it must not run code. The layout is

    header      magic, format, bytes of the values, digest of all that follows
    values      msgpack, with a reference in the place of each array
    arrays      their bytes, one after the other
"""

import hashlib
import struct
from collections.abc import Callable, Iterable
from typing import Any, TypeVar, cast

import msgpack
import numpy as np

from comotion_schemas.errors import KnownError

FORMAT = 15
"""Version of the layout and of the state in it."""
MAX_BYTES = 1 << 30
_MAGIC = b"comotion"
_HEADER = struct.Struct("<8sIQ16s")
_ARRAY = "__array__"
_SAFE_KINDS = "biuf"
_DIGEST_BYTES = 16
Built = TypeVar("Built")


def pieces(state: dict[str, Any]) -> list[Any]:
    """Serialise nested dicts and lists of plain values and numeric arrays, without a copy of the arrays.

    Returns buffers that make up the snapshot, in order.

    Raises
    ------
    TypeError
        If there is anything else in `state`.
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

    Raises
    ------
    ValueError
        If `data` is no snapshot of this version, or damaged, or `build` fails.
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
