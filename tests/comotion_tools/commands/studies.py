"""Options and checks that several studies share."""

from collections.abc import Sequence
from dataclasses import dataclass

from comotion_deploy.errors import UserError
from comotion_deploy.options import Command, option


@dataclass(kw_only=True)
class OnFamilies(Command):
    """Options of an experiment on stress families."""

    family: list[str] | None = option(
        None, "Stress family, or how several begin; may be repeated. Default: all.", metavar="NAME"
    )
    jobs: int = option(2, "Processes at once.", min=1, max=256)


@dataclass(kw_only=True)
class OnWorkcell(Command):
    """The option of an experiment on scenes of the workcell."""

    workcell: list[str] | None = option(
        None, "Workcell scene; may be repeated. Default: those of the report.", metavar="SCENE"
    )


def known_parts(parts: Sequence[str] | None, known: Sequence[str]) -> list[str]:
    """Check the parts of an experiment; none: all are meant.

    Raises
    ------
    UserError
        If there is no part of that name.
    """
    unknown = [part for part in parts or () if part not in known]
    if unknown:
        raise UserError(f"no part {unknown[0]!r}; one of {', '.join(known)}")
    return list(parts or ())
