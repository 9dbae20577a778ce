"""Recordings of a scene as MCAP files: write and repair. Needs the extra `record`.

:mod:`.file` writes one file, :mod:`.series` a sequence of files, :mod:`.process` is the recorder.
:mod:`.repair` recovers damaged files. Sources read recordings by ``comotion_sources.recordings``.
"""
