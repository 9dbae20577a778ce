"""Parameters of the default method in metric spaces; none of them is a length."""

from typing import Annotated

from pydantic import Field

from .groups import Group

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class RigidConfig(Group):
    """Parameters of the rigid-motion method; none depends on the scale of the scene."""

    frame_rate: Annotated[float, Field(gt=0, le=200)] = Field(
        default=15.0, description="Hz; rate of the common frames that trajectories are interpolated to"
    )
    rigidity_motion: Positive = Field(
        default=0.01, description="share; a body may deform by this share of a trajectory's rms displacement"
    )
    rigidity_extent: Positive = Field(
        default=0.0015, description="share; ... but not by more than this of the scene"
    )
    rigidity_contact: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.25,
        description="share; ... and by no less than this of what the trajectories of the scene do, rms",
    )
    looseness: Annotated[float, Field(ge=0, le=10)] = Field(
        default=1.0, description="factor of the variance by which bodies deform; 0: they are rigid"
    )
    residual_cap: Positive = Field(
        default=16.0,
        description="squared residual per dimension, in tolerances, from which on it costs no more",
    )
    outlier_share: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.5, description="share of the cap that a frame of an outlier costs"
    )
    pose_price: Positive = Field(
        default=1.0,
        description="half nats that a degree of freedom of a pose must gain beyond the noise it fits",
    )
    birth_price: Positive = Field(default=15.0, description="nat; price of a hypothesis beside its poses")
    membership_price: Annotated[float, Field(ge=0, le=100)] = Field(
        default=1.5,
        description="price of the memberships of a moving body, as a factor of the nats that it takes to say "
        "which trajectories they are",
    )
    stay: Annotated[float, Field(ge=0, le=100)] = Field(
        default=2.0, description="nat; preference of a trajectory for its hypothesis"
    )
    prior_weight: Annotated[float, Field(ge=0, le=10)] = Field(
        default=1.0, description="weight of the spatial prior (log density of each hypothesis' members)"
    )
    prior_floor: Positive = Field(default=6.0, description="nat; most that the spatial prior may cost")
    min_life: Annotated[float, Field(ge=0.1, le=10)] = Field(
        default=0.3,
        description="s of observation from which on a trajectory takes part in finding hypotheses",
    )
