"""Bytes to disk in whole chunks: what is in the file is complete, whatever fails."""

import contextlib
import os
from pathlib import Path


class ChunkStream:
    """What an MCAP writer writes into; nothing reaches the file before :meth:`commit`.

    Parameters
    ----------
    path
        The file; it must not exist.

    Raises
    ------
    OSError
        If it exists or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = create(path)
        self._pending = bytearray()
        self.committed = 0

    @property
    def pending(self) -> int:
        """Bytes that wait for :meth:`commit`."""
        return len(self._pending)

    def write(self, data: bytes) -> int:
        """Take bytes in."""
        self._pending += data
        return len(data)

    def tell(self) -> int:
        """Position in the file once everything is committed."""
        return self.committed + len(self._pending)

    def flush(self) -> None:
        """Do nothing: only the owner knows when a chunk is whole."""

    def commit(self) -> None:
        """Write what waits, wholly or not at all, and see it through to the disk.

        Raises
        ------
        OSError
            If the disk does not take it (full, gone, broken); the file ends where it ended before.
        """
        if not self._pending:
            return
        try:
            write_all(self._descriptor, bytes(self._pending))
        except OSError:
            self._pending.clear()
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self.committed)
                os.lseek(self._descriptor, self.committed, os.SEEK_SET)
            raise
        self.committed += len(self._pending)
        self._pending.clear()

    def close(self) -> None:
        """Close the file; what is not committed is forgotten."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def create(path: Path) -> int:
    """Make a file for writing; answers with its descriptor.

    Raises
    ------
    OSError
        If it exists or cannot be made; one line that names it.
    """
    try:
        return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise OSError(f"{path}: {error.strerror}") from None


def write_all(descriptor: int, data: bytes) -> None:
    """Write bytes and see them through to the disk.

    Raises
    ------
    OSError
        If not all of them could be written; some may have been.
    """
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]
    # Some file systems tell only now that there is no room.
    os.fdatasync(descriptor)


def free_bytes(folder: Path) -> int:
    """Room on the disk for a user without privileges."""
    usage = os.statvfs(folder)
    return usage.f_bavail * usage.f_frsize
