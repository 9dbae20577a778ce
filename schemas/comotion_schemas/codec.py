"""Messages to bytes and back. Every byte from outside is checked here, once.

`encode` never fails on a message that exists (unless it is too large); `decode` answers with a
valid message or a :class:`DecodeError` that names the protocol's rejection reason.
"""

from dataclasses import fields, is_dataclass
from typing import Any, TypeAlias, TypeVar, cast, get_args

import msgpack
import numpy as np
from pydantic import TypeAdapter, ValidationError

from .hypotheses import HypothesisUpdate
from .messages import JointStates, ObservationBatch, Preview, RejectionReason, Status, TruthBatch
from .types import MAX_BYTES

Message: TypeAlias = ObservationBatch | TruthBatch | JointStates | Preview | HypothesisUpdate | Status
M = TypeVar("M", ObservationBatch, TruthBatch, JointStates, Preview, HypothesisUpdate, Status)

MESSAGE_TYPES: tuple[type[Message], ...] = get_args(Message)
_BY_SCHEMA: dict[str, TypeAdapter[Message]] = {
    f"comotion.{kind.__name__}/1": TypeAdapter(kind) for kind in MESSAGE_TYPES
}
_REASONS: frozenset[str] = frozenset(get_args(RejectionReason))
_MAX_ITEMS = 100_000

# pydantic's own error types that mean something more precise than "schema".
_PYDANTIC_REASONS: dict[str, RejectionReason] = {
    "unexpected_keyword_argument": "unknown-field",
    "extra_forbidden": "unknown-field",
    "finite_number": "non-finite",
    "greater_than": "range",
    "greater_than_equal": "range",
    "less_than": "range",
    "less_than_equal": "range",
}


class DecodeError(ValueError):
    """A payload that is no valid message; `reason` is one of the protocol's rejection reasons."""

    def __init__(self, reason: RejectionReason, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason: RejectionReason = reason
        self.detail = detail


def encode(message: Message) -> bytes:
    """Serialise a message.

    Raises
    ------
    ValueError
        If the payload would exceed 16 MiB.
    """
    payload = cast("bytes", msgpack.packb(_to_wire(message), use_bin_type=True))
    if len(payload) > MAX_BYTES:
        raise ValueError(f"a message of {len(payload)} bytes exceeds the limit of {MAX_BYTES}")
    return payload


def decode(payload: bytes) -> Message:
    """Parse and validate a payload of any message type.

    Raises
    ------
    DecodeError
        With the reason the protocol names for it.
    """
    if len(payload) > MAX_BYTES:
        raise DecodeError("too-large", f"{len(payload)} bytes exceed the limit of {MAX_BYTES}")
    content = _unpack(payload)
    name = content.get("schema")
    adapter = _BY_SCHEMA.get(name) if isinstance(name, str) else None
    if adapter is None:
        raise DecodeError("schema", "unknown or missing schema")
    try:
        return adapter.validate_python(content)
    except ValidationError as error:
        raise _decode_error(error) from None


def decode_as(kind: type[M], payload: bytes) -> M:
    """Like :func:`decode`, for a key that carries one message type only.

    Raises
    ------
    DecodeError
        Also with reason ``schema`` if the payload is a valid message of another type.
    """
    message = decode(payload)
    if not isinstance(message, kind):
        raise DecodeError("schema", f"expected {kind.__name__}, got {type(message).__name__}")
    return message


def _unpack(payload: bytes) -> dict[str, Any]:
    try:
        content = msgpack.unpackb(
            payload,
            raw=False,
            strict_map_key=True,
            object_pairs_hook=_unique_map,
            max_array_len=_MAX_ITEMS,
            max_map_len=_MAX_ITEMS,
            max_ext_len=0,
        )
    except DecodeError:
        raise
    except Exception as error:  # msgpack raises many types on hostile bytes; all mean the same here
        raise DecodeError("malformed", f"not msgpack: {type(error).__name__}") from None
    if not isinstance(content, dict):
        raise DecodeError("malformed", "not a map")
    return content


def _unique_map(pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) != len(pairs):
        raise DecodeError("malformed", "a map repeats a key")
    if not all(isinstance(key, str) for key in content):
        raise DecodeError("malformed", "a map key is not a string")
    return content


def _decode_error(error: ValidationError) -> DecodeError:
    first = error.errors(include_url=False, include_input=False)[0]
    kind = first["type"]
    reason = kind if kind in _REASONS else _PYDANTIC_REASONS.get(kind, "schema")
    where = ".".join(str(part) for part in first["loc"])[:200]
    detail = f"{where}: {first['msg']}" if where else first["msg"]
    return DecodeError(cast("RejectionReason", reason), detail[:500])


def _to_wire(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if is_dataclass(value):
        pairs = ((f.name, getattr(value, f.name)) for f in fields(value))
        return {name: _to_wire(item) for name, item in pairs if item is not None}
    if isinstance(value, list):
        return [_to_wire(item) for item in value]
    return value
