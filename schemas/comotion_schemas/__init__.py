"""Messages, keys, codec, QoS and session settings of the comotion wire protocol.

Importing this package does not import zenoh; :mod:`comotion_schemas.transport` does.
"""

from .codec import MESSAGE_TYPES, DecodeError, Message, decode, decode_as, decode_on, encode
from .hypotheses import Box, Event, Hypothesis, HypothesisUpdate, Joint, Pose, SourceRef, Twist
from .keys import DEFAULT_SCENE, QOS, Keys, QoS
from .messages import JointStates, ObservationBatch, Preview, Problem, RejectionReason, Status, TruthBatch
from .types import MAX_BYTES, UNDETERMINED

__all__ = [
    "DEFAULT_SCENE",
    "MAX_BYTES",
    "MESSAGE_TYPES",
    "QOS",
    "UNDETERMINED",
    "Box",
    "DecodeError",
    "Event",
    "Hypothesis",
    "HypothesisUpdate",
    "Joint",
    "JointStates",
    "Keys",
    "Message",
    "ObservationBatch",
    "Pose",
    "Preview",
    "Problem",
    "QoS",
    "RejectionReason",
    "SourceRef",
    "Status",
    "TruthBatch",
    "Twist",
    "decode",
    "decode_as",
    "decode_on",
    "encode",
]
