"""Parameters of the method of the thesis."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Clustering = Literal["divisive-kmeans", "gmm-bic", "eigengap", "eigengap-normalized"]
Unit = Literal["m", "px"]

# What "null" and "auto" stand for, by unit of the space.
_SIGMA_SWITCH: dict[Unit, float] = {"m": 0.02, "px": 8.0}
_V_MOVE: dict[Unit, float] = {"m": 0.1, "px": 20.0}

# Bounded away from zero: its square must not vanish.
Positive = Annotated[float, Field(ge=1e-9, le=1e9)]


class ThesisConfig(BaseModel):
    """Parameters of the method of the thesis."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    sigma_switch: Positive | None = Field(
        default=None,
        description="m or px; standard deviation of a distance where the affinity is 0.5; "
        "null: 0.02 m or 8 px",
    )
    v_move: Positive | Literal["auto"] | None = Field(
        default="auto",
        description="m/s or px/s; speed at which a feature weighs 0.9; "
        "auto: 0.1 m/s or 20 px/s, null: equal weights",
    )
    stop_affinity: Annotated[float, Field(ge=0, lt=1)] = Field(
        default=0.4, description="a cluster is split while its smallest affinity is not above this"
    )
    clustering: Clustering = Field(default="divisive-kmeans", description="how the affinities are clustered")

    def switch_for(self, unit: Unit) -> float:
        """Standard deviation where the affinity is 0.5, in `unit`."""
        return _SIGMA_SWITCH[unit] if self.sigma_switch is None else self.sigma_switch

    def v_move_for(self, unit: Unit) -> float | None:
        """Speed of (3.2)'s λ in `unit` per second, or None for equal weights."""
        return _V_MOVE[unit] if self.v_move == "auto" else self.v_move
