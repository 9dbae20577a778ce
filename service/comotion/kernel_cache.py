"""Where compiled kernels are kept on disk, and what they are kept by.

Numba keys the compiled code of a function by the file that defines it: a changed callee in another file
would be served as it was. Here every kernel is kept by one digest over all modules that hold kernels.
"""

import hashlib
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import llvmlite.binding as llvm
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


@cache
def _no_bitcode() -> bytes:
    module: bytes = llvm.parse_assembly("").as_bitcode()
    return module


class _KernelCacheImpl(CompileResultCacheImpl):
    _locator_classes = [_UserProvided, _InTree, _UserWide]  # noqa: RUF012 - as in the base class

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """Make a kernel of what was saved.

        Numba reads a kernel's bitcode at once, which takes longer than to link the machine code. It is only
        needed when another kernel that calls this one is compiled. All of this is private to numba: where a
        version has it otherwise, kernels are read as numba reads them.
        """
        try:
            (name, kind, (machine_code, bitcode)), description, *rest = payload
            # Numba would find the kernel's symbols in the bitcode; this one is looked up.
            symbols: set[str] = target_context.codegen()._engine._defined_symbols
            symbol = description.llvm_cpython_wrapper_name
        except (AttributeError, TypeError, ValueError):
            return super().rebuild(target_context, payload)  # type: ignore[no-untyped-call]
        symbols.add(symbol)
        library = name, kind, (machine_code, _no_bitcode())
        result = super().rebuild(target_context, (library, description, *rest))  # type: ignore[no-untyped-call]
        result.library._get_module_for_linking = cache(lambda: llvm.parse_bitcode(bitcode))
        return result


class KernelCache(FunctionCache):
    """Compiled code of one kernel on disk.

    Raises
    ------
    RuntimeError
        If neither the package's folder nor the user's cache can be written to.
    """

    _impl_class = _KernelCacheImpl
    _contexts: ClassVar[set[int]] = set()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load what was compiled for a signature; None if it is not on the disk.

        The base class looks for new types and functions before each, which takes as long as the loading. The
        compiler looks for itself.
        """
        if id(target_context) not in self._contexts:
            target_context.refresh()
            self._contexts.add(id(target_context))
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]

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
