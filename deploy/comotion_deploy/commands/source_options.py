"""Options that several source commands share."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from ..options import Command, Process, setting

if TYPE_CHECKING:
    from comotion_sources.parts import Part

Stamps = Literal["now", "original"]
"""Stamps of recorded data: the time of publication, or those of the recording."""


@dataclass(kw_only=True)
class Timed(Command):
    """The option of a source that may end by itself."""

    duration: float | None = setting(None, "Stop after this time.", min=0, metavar="SECONDS")


@dataclass(kw_only=True)
class Played(Timed, Process):
    """Options of a source that plays a scene or a recording, as one source or several."""

    rate: str | None = setting(
        None,
        "Rate, or one rate per source for several sources. Default: that of the scene.",
        metavar="HZ[,HZ...]",
    )
    part: str | None = setting(
        None,
        "Publish only the K-th of N sources; each feature belongs to exactly one of them.",
        metavar="K/N",
    )
    loop: bool = setting(False, "Repeat; each pass is a new session.")
    start_at: str = setting(
        "now",
        "Start now, at a multiple of the length of the scene or recording, or at a Unix time. "
        "Sources in several processes need 'aligned' or a Unix time to be in phase.",
        metavar="now|aligned|SECONDS",
    )
    name: str | None = setting(
        None,
        "Name of the source; with several, NAME-1, NAME-2, ... Default: that of the command.",
        env="COMOTION_SOURCE_NAME",
    )

    def chosen_part(self) -> "Part | None":
        """Return the part of the sources that is to be published, if not all are."""
        from comotion_sources.parts import parse_part

        return parse_part(self.part) if self.part else None

    def rates(self) -> "list[float] | None":
        """Return the rate of each source, or of all of them, in Hz."""
        from comotion_sources.parts import parse_rates

        return parse_rates(self.rate) if self.rate else None
