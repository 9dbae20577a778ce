"""Fuses feature trajectories from several sources into hypotheses of rigid bodies."""
