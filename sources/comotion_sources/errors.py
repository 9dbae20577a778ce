"""Errors of sources that a user can correct; each message is one line."""

from pydantic import ValidationError

from comotion_schemas.errors import KnownError


class InputError(KnownError):
    """An input cannot be used; the base of all errors below and beside."""


class SceneError(InputError):
    """A scene does not exist or is malformed."""


class RecordingError(InputError):
    """A recording is missing, truncated, empty or of an unknown format."""


def describe(error: ValidationError) -> str:
    """Format the first validation error as one line: field, then message."""
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"])
    message = " ".join(first["msg"].removeprefix("Value error, ").split())
    return f"{place}: {message}" if place else message
