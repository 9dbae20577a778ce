"""Recordings of a scene as MCAP files: write, repair, export. Needs the extra `record`.

:mod:`.file` writes one file, :mod:`.series` a sequence of files, :mod:`.process` is the recorder.
:mod:`.repair` recovers damaged files, :mod:`.export` converts a recording for Foxglove. Sources read
recordings by ``comotion_sources.recordings``.
"""
