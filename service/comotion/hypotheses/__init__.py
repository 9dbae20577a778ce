"""Hypotheses: identities of groups over time, and events."""
