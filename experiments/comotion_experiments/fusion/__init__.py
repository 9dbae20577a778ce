"""The fusion experiment: gain of fusing cameras and robot joints on the workcell, with truth."""

from .experiment import Results, Verdict, run_experiment, verdict
from .setup import QUICK, SCENES, Setup

__all__ = ["QUICK", "SCENES", "Results", "Setup", "Verdict", "run_experiment", "verdict"]
