"""The error of those who call or configure us, apart from defects of our own."""

from collections.abc import Iterator
from contextlib import contextmanager

from pydantic import ValidationError


class Error(ValueError):
    """Something given is wrong; the message says what, in one line. ``comotion.Error`` for users.

    Commands print it without a trace. Any other :class:`ValueError` is a defect, whose trace is kept.
    """

    __module__ = "comotion"  # the name that a trace shows is the one to catch


KnownError = Error
"""Name of the error within the packages."""


class InputError(Error):
    """An input cannot be used; the base of the errors of all readers."""


class RecordingError(InputError):
    """A recording is missing, truncated, empty or of an unknown format."""


def describe(error: ValidationError) -> str:
    """Format the first validation error as one line: field, then message."""
    first = error.errors(include_url=False)[0]
    # A caller does not know how a field that takes a number or a column is told apart.
    place = ".".join(str(part) for part in first["loc"] if part not in {"number", "column"})
    message = " ".join(first["msg"].removeprefix("Value error, ").split())
    return f"{place}: {message}" if place else message


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Raise a validation error as an :class:`Error` with one line."""
    try:
        yield
    except ValidationError as error:
        raise Error(describe(error)) from None
