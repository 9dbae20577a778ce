"""The state of a fusion as plain values and arrays in, bytes out; and back.

Not pickle: a state file is data from outside, and reading it must not run code.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import msgpack
import numpy as np

FORMAT = "comotion.Snapshot/4"
_ARRAY = "__array__"
_SAFE_KINDS = "biuf"
Built = TypeVar("Built")


def dump(state: dict[str, Any]) -> bytes:
    """Serialise nested dicts and lists of plain values and numeric arrays.

    Raises
    ------
    TypeError
        If there is anything else in them.
    """
    content = {"format": FORMAT} | state
    return cast("bytes", msgpack.packb(content, default=_pack_array, use_bin_type=True))


def load(data: bytes, build: Callable[[dict[str, Any]], Built]) -> Built:
    """Return what `build` makes of the state in `data`; its arrays are writeable.

    Raises
    ------
    ValueError
        If `data` is no snapshot of this version, or damaged so that `build` fails.
    """
    try:
        state = msgpack.unpackb(data, raw=False, strict_map_key=False, object_hook=_unpack_array)
    except Exception as error:
        raise ValueError(f"not a snapshot: {type(error).__name__}") from None
    if not isinstance(state, dict):
        raise ValueError("not a snapshot: not a map")
    if state.get("format") != FORMAT:
        raise ValueError(f"not a snapshot: format {str(state.get('format'))[:40]!r}, expected {FORMAT!r}")
    try:
        return build(state)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"damaged snapshot: {type(error).__name__} {error}") from None


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
