"""Grouping in the image: the method of spaces in pixels.

Distance variance is no rigid invariant in the image. Here trajectories are compared by the local
motions that explain both and by the subspace they span together; parts that the affine view of
motion tells apart are joined when one epipolar geometry explains them.

    window -> key frames -> local motions -> preferences  ┐
                         -> shape interaction             ┴> similarity -> pieces -> merging -> hypotheses
"""
