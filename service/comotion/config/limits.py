"""Bounds on what sources may make the service hold; who exceeds one loses data of his own."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class LimitsConfig(BaseModel):
    """Bounds of a scene, and of one source where that is said."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    sources: Annotated[int, Field(ge=1, le=65_536)] = Field(
        1024, description="source names at a time; the one silent for longest goes"
    )
    spaces: Annotated[int, Field(ge=1, le=4096)] = Field(
        256, description="coordinate spaces at a time; one that nobody publishes goes"
    )
    instants: Annotated[int, Field(ge=1, le=100_000)] = Field(
        1024, description="different row stamps in one batch"
    )
    waiting: Annotated[float, Field(ge=1, le=4096)] = Field(
        64.0, description="MB of batches of one source that wait for the watermark"
    )
    waiting_all: Annotated[float, Field(ge=1, le=65_536)] = Field(
        256.0, description="MB of batches of all sources that wait; beyond it, each source has its share"
    )
    waiting_batches: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        4096, description="batches of one source that wait for the watermark"
    )
    extent: Annotated[float, Field(ge=0, le=1e9)] = Field(
        200.0,
        description="rows so many times farther out than the other sources of the space see (at least 1 m or "
        "1000 px) are refused; 0: none",
    )
    expiry: Annotated[float, Field(gt=0, le=86_400)] = Field(
        60.0, description="s without data after which a source, and an empty space, is forgotten"
    )
    release: Annotated[float, Field(gt=0, le=86_400)] = Field(
        5.0, description="s without data after which a space may be published with another unit or dim"
    )
    processing: Annotated[float, Field(gt=0, le=1)] = Field(
        0.5, description="share of a period for taking in batches; each source has its share of that"
    )
    shedding: bool = Field(
        default=True, description="leave out searches when updates take longer than a period"
    )
    queries: Annotated[float, Field(gt=0, le=1)] = Field(
        0.1, description="share of a period for answering queries; one a period is always answered"
    )
