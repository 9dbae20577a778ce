"""Grouping in pixel space on labelled recordings: error, number of objects, time."""
