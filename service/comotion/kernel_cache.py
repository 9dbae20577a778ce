"""Where compiled kernels are kept on disk, and what they are kept by.

Numba keys the compiled code of a function by the file that defines it: a changed callee in another file
would be served as it was. Here every kernel is kept by one digest over all modules that hold kernels.
"""

import hashlib
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)

_PACKAGE = Path(__file__).parent
_MARK = b"@compiled"
# Modules without kernels whose constants go into them, as tests/unit/test_kernel_cache.py finds.
_USED_BY_KERNELS = {"compiled.py", "partition.py"}


def kernel_sources() -> Iterator[Path]:
    """All modules of the package that hold kernels, or constants of kernels."""
    for path in sorted(_PACKAGE.rglob("*.py")):
        if path.name in _USED_BY_KERNELS or _MARK in path.read_bytes():
            yield path


@cache
def source_digest() -> str:
    """Hexadecimal digest of :func:`kernel_sources`."""
    digest = hashlib.sha256()
    for path in kernel_sources():
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _library_digest() -> str:
    return hashlib.sha256(f"{numba.__version__} {np.__version__}".encode()).hexdigest()[:8]


class _ByDigest:
    """Names a kernel's files by the digests; files of other digests are never read.

    Numba adds the processor's features to the key, and the file of the kernel itself, which need not be
    of this package.
    """

    def get_disambiguator(self) -> str:
        line: str = super().get_disambiguator()  # type: ignore[misc]
        return f"{line}-{source_digest()}-{_library_digest()}"


class _UserProvided(_ByDigest, UserProvidedCacheLocator):
    pass


class _InTree(_ByDigest, InTreeCacheLocator):
    pass


class _UserWide(_ByDigest, UserWideCacheLocator):
    pass


class _KernelCacheImpl(CompileResultCacheImpl):
    _locator_classes = [_UserProvided, _InTree, _UserWide]  # noqa: RUF012 - as in the base class


class KernelCache(FunctionCache):
    """Compiled code of one kernel on disk.

    Raises
    ------
    RuntimeError
        If neither the package's folder nor the user's cache can be written to.
    """

    _impl_class = _KernelCacheImpl

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save what was compiled, and remove what other versions of the sources have left."""
        super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        for file in Path(self.cache_path).glob("*.nb[ic]"):
            if source_digest() not in file.name:
                with suppress(OSError):  # another process was faster
                    file.unlink()

    def signatures(self, target_context: Any) -> list[Any]:
        """Signatures that are on the disk for this processor."""
        codegen = target_context.codegen()
        index = self._cache_file._load_index()  # type: ignore[no-untyped-call]
        keys = ((key, self._index_key(key[0], codegen)) for key in index)  # type: ignore[no-untyped-call]
        return [key[0] for key, expected in keys if key == expected]
