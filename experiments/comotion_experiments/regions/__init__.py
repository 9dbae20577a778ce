"""Dense regions: how well they cover the true objects of the workcell."""

from comotion_clients.regions import NOBODY, intersection_over_union, nearest, regions

__all__ = ["NOBODY", "intersection_over_union", "nearest", "regions"]
