"""Joints: how one body can move against another."""
