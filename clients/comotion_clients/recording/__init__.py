"""Recordings of a scene as MCAP files: write, repair, export. Needs the extra `record`.

:mod:`.file` writes one file, :mod:`.series` several that follow each other, :mod:`.process` is the
recorder; :mod:`.repair` saves what a crash has left, :mod:`.export` makes a file that Foxglove shows.
Reading is the business of the sources: ``comotion_sources.recordings``.
"""
