"""Errors of sources that a user can correct; each message is one line."""

from comotion_schemas.errors import InputError, RecordingError

__all__ = ["InputError", "RecordingError", "SceneError"]


class SceneError(InputError):
    """A scene does not exist or is malformed."""
