"""Messages for tests: what a test does not say has a plain value."""

from typing import Any

import numpy as np

from comotion_schemas import HypothesisUpdate, ObservationBatch, SourceRef, Status

SESSION = "0123456789abcdef"


def batch(**fields: Any) -> ObservationBatch:
    """Observations of the source `cam` in the space `world`, in m; without ids, of nothing."""
    plain = {
        "source": "cam",
        "session": SESSION,
        "seq": 0,
        "space": "world",
        "unit": "m",
        "dim": 3,
        "ids": [],
    }
    found = plain | {"stamp_ns": 0} | fields
    found.setdefault("positions", np.zeros((len(found["ids"]), found["dim"]), np.float32))
    return ObservationBatch(**found)


def update(**fields: Any) -> HypothesisUpdate:
    """An update of the scene `default`; its tracks are sure, at the origin, and of the first source."""
    count, stamp_ns = len(fields.get("track_id", ())), fields.get("stamp_ns", 0)
    plain = {
        "scene": "default",
        "session": SESSION,
        "seq": 0,
        "stamp_ns": stamp_ns,
        "published_ns": stamp_ns,
        "period_ns": 10**8,
        "sources": [SourceRef(name="cam", session=SESSION)] if count else [],
        "track_source": [0] * count,
        "track_id": [],
        "track_hypothesis": [],
        "track_confidence": [1.0] * count,
        "track_position": np.zeros((count, 3), np.float32),
        "hypotheses": [],
        "events": [],
    }
    return HypothesisUpdate(**(plain | fields))


def status(**fields: Any) -> Status:
    """The Status of the service `fusion`, which is well."""
    maps = {name: {} for name in ("rates", "ages", "counters", "rejected")}
    plain = {"component": "fusion", "role": "service", "session": SESSION, "stamp_ns": 0, "state": "ok"}
    return Status(**(plain | maps | {"message": ""} | fields))
