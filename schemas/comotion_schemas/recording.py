"""Layout of recordings: how the messages of a scene are stored in an MCAP file.

| MCAP | content |
|---|---|
| profile | ``comotion`` |
| topic of a channel | the Zenoh key |
| message encoding | ``msgpack`` |
| schema | name ``comotion.<Message>/1``, encoding ``jsonschema``: the header's JSON Schema |
| message data | the payload, byte for byte, also one that is not valid |
| log time | receipt, by the recorder's wall clock |
| publish time | the acquisition stamp in the payload; the log time where there is none |
| sequence | the payload's ``seq``, its lower 32 bits; 0 where there is none |
| metadata ``comotion`` | scene, number of the file, version; at the end of a file what was lost |

Times in MCAP are unsigned: a stamp before 1970 is replaced by the log time.
"""

from .codec import Message
from .messages import TruthBatch

PROFILE = "comotion"
MESSAGE_ENCODING = "msgpack"
SCHEMA_ENCODING = "jsonschema"
METADATA = "comotion"
LOSSES = "comotion.losses"
SUFFIX = ".mcap"
_SEQUENCE_MASK = 0xFFFF_FFFF


def publish_time(message: Message | None, log_ns: int) -> int:
    """Return the MCAP publish time of a message, ns: its acquisition time, or else `log_ns`."""
    if message is None or isinstance(message, TruthBatch) or message.stamp_ns < 0:
        return log_ns
    return message.stamp_ns


def sequence(message: Message | None) -> int:
    """Return the MCAP sequence number of a message."""
    return int(getattr(message, "seq", 0)) & _SEQUENCE_MASK
