"""Links between spaces: which image hypotheses and rigid bodies are one, by motion."""

from ..config import Camera

__all__ = ["Camera"]
