"""The first hour of a newcomer, in a clean environment from the wheel."""

import pytest

from .first_hour import first_hour


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_every_step_of_the_first_hour_works_and_says_something(tmp_path):
    steps = {one.name: one for one in first_hour(tmp_path)}
    assert {name for name, one in steps.items() if one.status} == {"comotion evaluate ms.npz"}
    assert steps["comotion evaluate ms.npz"].status == 2
    assert "look like milliseconds" in steps["comotion evaluate ms.npz"].lines[-1][1]
    for name in ("first", "again"):
        assert steps[f"comotion.group, {name}"].lines[-1][1] == "Grouping(90 x 30, 2 hypotheses, 1 at rest)"
    assert "kernels, once" in steps["comotion.group, first"].lines[0][1]
    assert not any("compiling" in text for _, text in steps["comotion.group, again"].lines)
