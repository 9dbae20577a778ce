"""Options that several source commands share."""

from enum import StrEnum
from typing import Annotated

import typer

from .. import options


class StampChoice(StrEnum):
    """Stamps of recorded data: the time of publication, or those of the recording."""

    NOW = "now"
    ORIGINAL = "original"


Name = Annotated[
    str,
    typer.Option(
        "--name",
        envvar="COMOTION_SOURCE_NAME",
        callback=options.name_of_certificate,
        help="Name of the source. With a certificate: its name.",
    ),
]
Names = Annotated[
    str | None,
    typer.Option(
        "--name",
        envvar="COMOTION_SOURCE_NAME",
        callback=options.name_of_certificate,
        help="Name of the source; with several, NAME-1, NAME-2, ... Default: that of the command.",
    ),
]
Loop = Annotated[
    bool, typer.Option("--loop", envvar="COMOTION_LOOP", help="Repeat; each pass is a new session.")
]
Duration = Annotated[
    float | None,
    typer.Option("--duration", envvar="COMOTION_DURATION", min=0, help="Stop after this time, s."),
]
Part = Annotated[
    str | None,
    typer.Option(
        "--part",
        envvar="COMOTION_PART",
        metavar="K/N",
        help="Publish only the K-th of N sources; each feature belongs to exactly one of them.",
    ),
]
StartAt = Annotated[
    str,
    typer.Option(
        "--start-at",
        envvar="COMOTION_START_AT",
        metavar="now|aligned|SECONDS",
        help="Start now, at a multiple of the length of the scene or recording, or at a Unix time. "
        "Sources in several processes need 'aligned' or a Unix time to be in phase.",
    ),
]
