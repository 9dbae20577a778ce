"""Plain values and NumPy arrays to bytes and back, for snapshots.

Not pickle: a state file is data from outside, and reading it must not run code.
"""

from typing import Any, cast

import msgpack
import numpy as np

_ARRAY = "__array__"
_SAFE_KINDS = "biuf"


def pack(value: dict[str, Any]) -> bytes:
    """Serialise nested dicts and lists of plain values and numeric arrays."""
    return cast("bytes", msgpack.packb(value, default=_pack_array, use_bin_type=True))


def unpack(data: bytes) -> dict[str, Any]:
    """Inverse of :func:`pack`; arrays come back writeable.

    Raises
    ------
    ValueError
        If `data` is not what :func:`pack` wrote.
    """
    try:
        value = msgpack.unpackb(data, raw=False, strict_map_key=False, object_hook=_unpack_array)
    except Exception as error:
        raise ValueError(f"not a snapshot: {type(error).__name__}") from None
    if not isinstance(value, dict):
        raise ValueError("not a snapshot: not a map")
    return value


def _pack_array(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in _SAFE_KINDS:
        return {_ARRAY: [value.dtype.str, list(value.shape), value.tobytes()]}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot store a {type(value).__name__}")


def _unpack_array(value: dict[Any, Any]) -> Any:
    if _ARRAY not in value:
        return value
    dtype, shape, data = value[_ARRAY]
    kind = np.dtype(dtype)
    if kind.kind not in _SAFE_KINDS:
        raise ValueError("not a numeric array")
    return np.frombuffer(data, kind).reshape(shape).copy()
