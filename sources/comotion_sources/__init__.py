"""Processes that observe: simulator, cameras, proprioception, replay."""
