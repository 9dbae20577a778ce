"""Hypotheses: partitions in, identities over time and events out."""
