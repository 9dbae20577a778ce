"""The default method in metric spaces: rigid bodies with a motion."""
