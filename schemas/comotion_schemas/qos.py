"""Quality of service per kind of key.

All streams drop messages under congestion: with BLOCK one stuck subscriber would stall the others.
"""

from dataclasses import dataclass
from typing import Literal

from .keys import Kind

PriorityName = Literal[
    "REAL_TIME", "INTERACTIVE_HIGH", "INTERACTIVE_LOW", "DATA_HIGH", "DATA", "DATA_LOW", "BACKGROUND"
]


@dataclass(frozen=True, slots=True)
class QoS:
    """Quality of service of one kind of key.

    Attributes
    ----------
    message
        Name of the message type.
    priority
        Zenoh priority; lower priorities wait on a full link.
    express
        Send at once, without batching small messages.
    reliable
        Request reliable links.
    cache
        Samples that the publisher keeps for late joiners; 0: none.
    """

    message: str
    priority: PriorityName
    express: bool
    reliable: bool
    cache: int

    @property
    def encoding(self) -> str:
        """Zenoh encoding of the payload."""
        return f"application/msgpack;comotion.{self.message}/1"


QOS: dict[Kind, QoS] = {
    "obs": QoS("ObservationBatch", "INTERACTIVE_HIGH", express=True, reliable=True, cache=0),
    "joints": QoS("JointStates", "INTERACTIVE_HIGH", express=True, reliable=True, cache=0),
    "hypotheses": QoS("HypothesisUpdate", "DATA_HIGH", express=True, reliable=True, cache=1),
    "truth": QoS("TruthBatch", "DATA", express=False, reliable=True, cache=4096),
    "status": QoS("Status", "DATA_LOW", express=False, reliable=True, cache=1),
    "preview": QoS("Preview", "BACKGROUND", express=False, reliable=False, cache=0),
}

HEARTBEAT_S = 0.5
"""Heartbeat of cached publishers; without it several publishers in one session lose their last samples."""
