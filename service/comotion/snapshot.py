"""Serialises the state of a fusion as checked bytes, and reads it back.

Not pickle: a state file is data from outside, and reading it must not run code. The layout is

    header      magic, format, sizes, digest of all that follows, next hypothesis id; its own checksum
    values      msgpack, with a reference in the place of each array
    arrays      their bytes, one after the other

The header can be read where the rest is damaged, so that no hypothesis id is given out twice.
"""

import hashlib
import struct
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Self, TypeVar, cast

import msgpack
import numpy as np

from comotion_schemas.errors import KnownError

FORMAT = 14
"""Version of the layout and of the state in it."""
MAX_BYTES = 1 << 30
_MAGIC = b"comotion"
_HEADER = struct.Struct("<8sIQQQ16s")
_CHECKSUM = struct.Struct("<I")
HEADER_BYTES = _HEADER.size + _CHECKSUM.size
_ARRAY = "__array__"
_SAFE_KINDS = "biuf"
_DIGEST_BYTES = 16
Built = TypeVar("Built")


@dataclass(frozen=True)
class Header:
    """Header of a snapshot: its sizes, its digest and the next hypothesis id.

    Attributes
    ----------
    values, arrays
        Bytes of the two parts that follow.
    following
        The next hypothesis id.
    digest
        BLAKE2b of all that follows, 16 bytes.
    """

    values: int
    arrays: int
    following: int
    digest: bytes

    @property
    def total(self) -> int:
        """Bytes of the whole snapshot."""
        return HEADER_BYTES + self.values + self.arrays

    def pack(self) -> bytes:
        """As bytes, with a checksum of its own."""
        fields = _HEADER.pack(_MAGIC, FORMAT, self.values, self.arrays, self.following, self.digest)
        return fields + _CHECKSUM.pack(zlib.crc32(fields))

    @classmethod
    def read(cls, data: bytes) -> Self:
        """Read it from the first bytes of a snapshot.

        Raises
        ------
        ValueError
            If they are no header of this format, or damaged.
        """
        if not data.startswith(_MAGIC):
            raise KnownError("not a snapshot")
        if len(data) < HEADER_BYTES:
            raise KnownError("damaged snapshot: it ends within its header")
        if _CHECKSUM.unpack_from(data, _HEADER.size)[0] != zlib.crc32(data[: _HEADER.size]):
            raise KnownError("damaged snapshot: the checksum of its header is wrong")
        _, version, values, arrays, following, digest = _HEADER.unpack_from(data)
        if version != FORMAT:
            raise KnownError(f"not a snapshot of this version: format {version}, expected {FORMAT}")
        return cls(values, arrays, following, digest)


def pieces(state: dict[str, Any], following: int = 0) -> list[Any]:
    """Serialise nested dicts and lists of plain values and numeric arrays, without a copy of the arrays.

    `following` is the next hypothesis id, for the header. Returns buffers that make up the snapshot, in
    order.

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
    return [Header(len(values), size, following, _digest([values, *parts])).pack(), values, *parts]


def load(data: bytes, build: Callable[[dict[str, Any]], Built]) -> Built:
    """Return what `build` makes of the state in `data`; its arrays are writeable.

    Raises
    ------
    ValueError
        If `data` is no snapshot of this version, or damaged, or `build` fails.
    """
    header = Header.read(data)
    if len(data) != header.total:
        raise KnownError(f"damaged snapshot: {len(data)} bytes, its header says {header.total}")
    body = memoryview(data)[HEADER_BYTES:]
    if _digest([body]) != header.digest:
        raise KnownError("damaged snapshot: its checksum is wrong")
    arrays = body[header.values :]
    try:
        state = msgpack.unpackb(
            body[: header.values],
            raw=False,
            strict_map_key=False,
            object_hook=lambda value: _resolve(value, arrays),
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
