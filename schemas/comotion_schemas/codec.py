"""Encodes messages, and decodes and validates all received bytes.

`encode` fails only on messages that are too large; `decode` returns a valid message or raises
:class:`DecodeError` with a rejection reason of the protocol.
"""

from dataclasses import fields, is_dataclass
from typing import Any, TypeAlias, TypeVar, cast, get_args

import msgpack
import numpy as np
from pydantic import TypeAdapter, ValidationError

from .errors import KnownError, describe
from .hypotheses import HypothesisUpdate
from .keys import QOS, kind_of, publisher_of
from .messages import JointStates, ObservationBatch, Preview, RejectionReason, Status, TruthBatch
from .text import shown
from .types import MAX_BYTES, WIRE

Message: TypeAlias = ObservationBatch | TruthBatch | JointStates | Preview | HypothesisUpdate | Status
M = TypeVar("M", ObservationBatch, TruthBatch, JointStates, Preview, HypothesisUpdate, Status)

MESSAGE_TYPES: tuple[type[Message], ...] = get_args(Message)
_BY_SCHEMA: dict[str, TypeAdapter[Message]] = {
    f"comotion.{kind.__name__}/1": TypeAdapter(kind) for kind in MESSAGE_TYPES
}
_REASONS: frozenset[str] = frozenset(get_args(RejectionReason))
# Limits of one map or list, and of all together: 16 MiB of empty maps would take 1 GB of memory.
_MAX_ITEMS = 100_000
_MAX_TOTAL = 500_000

# Error types of pydantic with a more specific rejection reason than "schema".
_SPECIFIC: dict[RejectionReason, tuple[str, ...]] = {
    "unknown-field": ("unexpected_keyword_argument", "extra_forbidden"),
    "non-finite": ("finite_number",),
    "range": ("greater_than", "greater_than_equal", "less_than", "less_than_equal"),
    "length": ("too_short", "too_long", "string_too_short", "string_too_long"),
}
_PYDANTIC_REASONS = {kind: reason for reason, kinds in _SPECIFIC.items() for kind in kinds}


class DecodeError(KnownError):
    """A payload is not a valid message; `reason` is a rejection reason of the protocol."""

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
    payload = cast("bytes", msgpack.packb(message, default=_to_wire, use_bin_type=True))
    if len(payload) > MAX_BYTES:
        raise KnownError(f"a message of {len(payload)} bytes exceeds the limit of {MAX_BYTES}")
    return payload


def decode(payload: bytes) -> Message:
    """Parse and validate a payload of any message type.

    Raises
    ------
    DecodeError
        If the payload is not a valid message.
    """
    if len(payload) > MAX_BYTES:
        raise DecodeError("too-large", f"{len(payload)} bytes exceed the limit of {MAX_BYTES}")
    content = _unpack(payload)
    name = content.get("schema")
    adapter = _BY_SCHEMA.get(name) if isinstance(name, str) else None
    if adapter is None:
        raise DecodeError("schema", "unknown or missing schema")
    try:
        return adapter.validate_python(content, context=WIRE)
    except ValidationError as error:
        kind = error.errors(include_url=False, include_input=False)[0]["type"]
        reason = kind if kind in _REASONS else _PYDANTIC_REASONS.get(kind, "schema")
        raise DecodeError(cast("RejectionReason", reason), shown(describe(error), 500)) from None


def decode_as(kind: type[M], payload: bytes) -> M:
    """Parse and validate a payload of one message type.

    Raises
    ------
    DecodeError
        As :func:`decode`; with the reason ``schema`` if it is a message of another type.
    """
    message = decode(payload)
    if not isinstance(message, kind):
        raise DecodeError("schema", f"expected {kind.__name__}, got {type(message).__name__}")
    return message


def decode_on(key: str, payload: bytes) -> Message:
    """Parse and validate a payload that has arrived on a key.

    Raises
    ------
    DecodeError
        As :func:`decode`; with the reason ``schema`` if the key is for another type of message, and
        ``source-mismatch`` if the message names another publisher than the key.
    """
    kind, message = kind_of(key), decode(payload)
    if kind is None or type(message).__name__ != QOS[kind].message:
        raise DecodeError("schema", f"a {type(message).__name__} on {shown(key, 200)}")
    if getattr(message, QOS[kind].publisher) != publisher_of(key):
        raise DecodeError("source-mismatch", f"published on {shown(key, 200)}")
    return message


def _unpack(payload: bytes) -> dict[str, Any]:
    total = 0

    def counted(items: list[Any]) -> list[Any]:
        nonlocal total
        total += len(items) + 1
        if total > _MAX_TOTAL:
            raise DecodeError("limit", f"more than {_MAX_TOTAL} items")
        return items

    limits = {"max_array_len": _MAX_ITEMS, "max_map_len": _MAX_ITEMS, "max_ext_len": 0}
    hooks = {"object_pairs_hook": lambda pairs: _as_map(counted(pairs)), "list_hook": counted}
    try:
        content = msgpack.unpackb(payload, raw=False, strict_map_key=True, **hooks, **limits)
    except DecodeError:
        raise
    except Exception as error:  # msgpack raises many types on malformed bytes
        raise DecodeError("malformed", f"not msgpack: {type(error).__name__}") from None
    if not isinstance(content, dict):
        raise DecodeError("malformed", "not a map")
    return content


def _as_map(pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) != len(pairs):
        raise DecodeError("malformed", "a map repeats a key")
    for key, value in pairs:
        if not isinstance(key, str):
            raise DecodeError("malformed", "a map key is not a string")
        if value is None:  # in the protocol an unset optional field is absent
            raise DecodeError("schema", f"{shown(key, 200)}: nil")
    return content


def _to_wire(value: Any) -> Any:
    """What msgpack does not know by itself: of a column the bytes, of a message or part what it has."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if is_dataclass(value):
        pairs = ((f.name, getattr(value, f.name)) for f in fields(value))
        return {name: item for name, item in pairs if item is not None}
    raise TypeError(f"{type(value).__name__} does not travel")
