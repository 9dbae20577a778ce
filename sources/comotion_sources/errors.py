"""The error of sources: an input that cannot be used; each message is one line."""

from comotion_schemas.errors import InputError, RecordingError

__all__ = ["InputError", "RecordingError"]
