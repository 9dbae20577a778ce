"""Ablation: each rule of the default method left out alone, and what that costs."""
