"""The first call says that it compiles, and goes on saying so; a later one is silent."""

import numba

from comotion.library import compiling


def test_compilation_is_told_once_and_reading_from_memory_is_not(capsys, monkeypatch) -> None:
    monkeypatch.setattr(compiling, "_installed", [])
    compiling.report_compiling()
    kernel = numba.njit(lambda x: x + 1)
    assert (kernel(1), kernel(1.0), kernel(2)) == (2, 2.0, 3)
    assert capsys.readouterr().err.splitlines()[0] == (
        "comotion: compiling, once; the result is kept on disk"
    )
    assert kernel(3) == 4
    assert capsys.readouterr().err == ""
