"""Image hypotheses and rigid bodies in; which of them are one by motion out: links between spaces."""

from ..config import Camera

__all__ = ["Camera"]
