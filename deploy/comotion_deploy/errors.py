"""Errors that a user can correct: reported as one line, without a traceback."""


class UserError(Exception):
    """A known error; its message is one line."""


def one_line(message: object) -> str:
    """Collapse a message to one line that can be shown."""
    # Not at the top: what comes with it takes longer than to show the help.
    from comotion_schemas.text import shown

    return shown(" ".join(str(message).split()))


def missing_extra(extra: str, error: ImportError) -> UserError:
    """Build the error for an optional dependency that is not installed."""
    package = (error.name or str(error)).partition(".")[0]
    return UserError(f"{package} is not installed: pip install 'comotion[{extra}]'")
