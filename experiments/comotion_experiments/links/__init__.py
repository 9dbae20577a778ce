"""The link experiment: links between bodies of a depth camera and hypotheses of one without, with truth."""

from .experiment import Results, run_experiment
from .picture import save_picture
from .setup import QUICK, SCENES, Setup

__all__ = ["QUICK", "SCENES", "Results", "Setup", "run_experiment", "save_picture"]
