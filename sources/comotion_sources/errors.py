"""Errors of sources that a user can correct; each message is one line."""

from comotion_schemas.errors import KnownError


class InputError(KnownError):
    """An input cannot be used; the base of all errors below and beside."""


class SceneError(InputError):
    """A scene does not exist or is malformed."""


class RecordingError(InputError):
    """A recording is missing, truncated, empty or of an unknown format."""
