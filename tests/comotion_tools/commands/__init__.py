"""The commands of ``comotion dev`` that are in a checkout alone; they import what is heavy when they run."""

from comotion_deploy.options import Command

from .bench import Bench
from .scenes import Ablation, Accuracy, Pixels, Stress
from .soak import Soak

TOOLS: dict[str, type[Command]] = {"bench": Bench, "soak": Soak}
STUDIES: dict[str, type[Command]] = {
    "ablation": Ablation,
    "stress": Stress,
    "pixels": Pixels,
    "accuracy": Accuracy,
}
"""Those of ``comotion dev reproduce``."""
