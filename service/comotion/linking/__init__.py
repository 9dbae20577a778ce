"""Links between spaces: which image hypotheses and which rigid bodies are one, by motion."""

from ..config import Camera

__all__ = ["Camera"]
