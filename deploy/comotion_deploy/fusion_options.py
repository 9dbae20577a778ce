"""The fusion parameters that a command line and its configuration file give."""

import json
from typing import TYPE_CHECKING, Any

from .config_file import file_table, spelling
from .errors import UserError
from .options import Command, setting

if TYPE_CHECKING:
    from comotion import FusionConfig


class Assignments(Command):
    """The option of a command that takes fusion parameters."""

    set_: list[str] | None = setting(
        None,
        "Set a fusion parameter; may be repeated. 'null' is None; see 'comotion config'.",
        metavar="NAME=VALUE",
    )

    def fusion_config(self, method: str | None = None) -> "FusionConfig":
        """Build the fusion parameters: ``[fusion]`` of the file, then `method`, then ``--set``.

        Raises
        ------
        UserError, ValueError
            For an unknown parameter or a value out of bounds.
        """
        from comotion.reading import put, read_config

        table = _read_null(file_table(self.ctx, "fusion"))
        values = {spelling(name): value for name, value in table.items()}
        if method is not None:
            values["method"] = method
        for text in self.set_ or ():
            put(values, *assignment(text))
        return read_config(values)


class Fusion(Assignments):
    """Options of a command that groups features, by the method that it is given."""

    method: str | None = setting(None, "Method: comotion or thesis.")

    def fusion_config(self, method: str | None = None) -> "FusionConfig":
        """Build the fusion parameters, with ``--method``."""
        return super().fusion_config(method or self.method)


def _read_null(value: Any) -> Any:
    """None for TOML's "null", in tables too."""
    if isinstance(value, dict):
        return {key: _read_null(content) for key, content in value.items()}
    return None if value == "null" else value


def assignment(text: str, flag: str = "--set") -> tuple[str, Any]:
    """Parse ``NAME=VALUE`` of an option; the value is JSON, or else a text.

    Raises
    ------
    UserError
        If it is not of this form.
    """
    name, separator, value = text.partition("=")
    if not separator or not name:
        raise UserError(f"{flag} {text}: expected NAME=VALUE")
    try:
        return spelling(name.strip()), json.loads(value)
    except ValueError:
        return spelling(name.strip()), value
