"""Errors that a user can correct: reported as one line, without a traceback."""

from pathlib import Path


class UserError(Exception):
    """A known error; its message is one line."""


def require_suffix(path: Path, what: str, *suffixes: str) -> None:
    """Refuse a file to write whose name does not end as it should.

    Raises
    ------
    UserError
        If it does not.
    """
    if path.suffix.lower() not in suffixes:
        raise UserError(f"{path}: the name of {what} ends in {' or '.join(suffixes)}")


def one_line(message: object) -> str:
    """Collapse a message to one line that can be shown."""
    # Not at the top: what comes with it takes longer than to show the help.
    from comotion_schemas.text import shown

    return shown(" ".join(str(message).split()))


_EXTRAS = {
    "cryptography": "secure",
    "etcd3gw": "cluster",
    "foxglove": "foxglove",
    "lz4": "record",
    "matplotlib": "plot",
    "mcap": "record",
    "prometheus_client": "metrics",
    "rerun": "view",
    "rerun_cli": "view",
    "rosbags": "ros",
    "zstandard": "record",
}


def missing_extra(error: ImportError) -> str | None:
    """Say how to install the optional dependency that an import lacks; None for any other import."""
    package = (error.name or "").partition(".")[0]
    extra = _EXTRAS.get(package) if isinstance(error, ModuleNotFoundError) else None
    return None if extra is None else f"{package} is not installed: pip install 'comotion[{extra}]'"
