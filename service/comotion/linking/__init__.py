"""Links between spaces: which image hypotheses and which rigid bodies are one, by motion."""

from .camera import Camera

__all__ = ["Camera"]
