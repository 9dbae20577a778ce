"""The reader of recorded scenes (MCAP), beside the other readers. Needs the extra `record`."""

from comotion_schemas.message_log import Logged, MessageLog, logged_batches

__all__ = ["Logged", "MessageLog", "logged_batches"]
