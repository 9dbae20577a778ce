"""Experiments: evaluate recordings offline, reproduce the figures of the thesis, and measure costs."""
