"""What links between a depth camera's bodies and a plain camera's hypotheses are worth, on the workcell."""

from .experiment import Results, run_experiment
from .picture import save_picture
from .setup import QUICK, SCENES, Setup

__all__ = ["QUICK", "SCENES", "Results", "Setup", "run_experiment", "save_picture"]
