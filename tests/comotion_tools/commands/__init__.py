"""The commands of ``comotion dev`` that are in a checkout alone; they import what is heavy when they run."""

from comotion_deploy.options import Command

from .bench import Bench
from .soak import Soak
from .studies import Ablation, Accuracy, Carried, Pixels, Stress

TOOLS: dict[str, type[Command]] = {"bench": Bench, "soak": Soak}
STUDIES: dict[str, type[Command]] = {
    "ablation": Ablation,
    "stress": Stress,
    "pixels": Pixels,
    "carried": Carried,
    "accuracy": Accuracy,
}
"""Those of ``comotion dev reproduce``."""
