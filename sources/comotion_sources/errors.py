"""Errors of sources that a user can mend; each message is one line."""

from pydantic import ValidationError


class SceneError(ValueError):
    """A scene that does not exist or is not well formed."""


class RecordingError(ValueError):
    """A recording that is missing, truncated, empty or no recording at all."""


def describe(error: ValidationError) -> str:
    """Put the first thing pydantic found wrong in one line, with the place it is at."""
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"])
    message = " ".join(first["msg"].removeprefix("Value error, ").split())
    return f"{place}: {message}" if place else message
