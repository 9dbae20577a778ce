"""Clients: subscribe to a scene, watch, view, record and evaluate it."""
