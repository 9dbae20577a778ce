"""Receives the hypotheses of one camera's features from the service."""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import zenoh

from comotion_schemas import DecodeError, Hypothesis, HypothesisUpdate, Keys, decode_on
from comotion_schemas.transport import declare_subscriber
from comotion_schemas.types import UNDETERMINED

_RING_UPDATES = 64
"""Updates kept between two polls: 6 s at 10 Hz."""


class HypothesisFeed:
    """Holds the newest hypothesis of each feature of one source; reading never blocks.

    Parameters
    ----------
    session, keys
        An open session and the keys of the scene.
    source
        Name of the source whose features are looked up.
    source_session
        Session of that source.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, source: str, source_session: str) -> None:
        self._source = (source, source_session)
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(_RING_UPDATES)
        self._subscriber: Any = declare_subscriber(session, keys.hypotheses, "hypotheses", ring)
        self.stamp_ns: int | None = None
        """Watermark of the newest update; None before the first."""
        self.listed: Sequence[Hypothesis] = []
        """All hypotheses of that update."""
        self._hypotheses: dict[int, int] = {}

    def poll(self) -> None:
        """Process the updates that arrived since the last call."""
        while (sample := self._subscriber.handler.try_recv()) is not None:
            try:
                update = cast("HypothesisUpdate", decode_on(str(sample.key_expr), sample.payload.to_bytes()))
            except DecodeError:
                continue
            if self.stamp_ns is None or update.stamp_ns >= self.stamp_ns:
                self._apply(update)

    def hypothesis(self, feature: int) -> int:
        """Return the hypothesis of a feature; UNDETERMINED if the service has not listed it."""
        return self._hypotheses.get(feature, UNDETERMINED)

    def close(self) -> None:
        """End the subscription."""
        self._subscriber.undeclare()

    def _apply(self, update: HypothesisUpdate) -> None:
        self.stamp_ns, self.listed = update.stamp_ns, update.hypotheses
        mine = [i for i, ref in enumerate(update.sources) if (ref.name, ref.session) == self._source]
        rows = np.isin(update.track_source, mine)
        pairs = zip(update.track_id[rows].tolist(), update.track_hypothesis[rows].tolist(), strict=True)
        self._hypotheses = dict(pairs)
