"""Processes that look: subscribe, watch, evaluate."""
