"""Row 6: without certificates, somebody says that the scene is his."""

import pytest

from comotion_tools.soak.attacks import NAME

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.timeout(900)]


@pytest.mark.parametrize("attack", ["seize", "outrank"])
def test_the_service_goes_on_and_clients_hear_it(fair, attack) -> None:
    assert fair(attack).updates > 50


def test_a_service_that_starts_beside_a_token_has_the_scene(enter) -> None:
    arena = enter()
    with arena.attacked_by("seize", 120.0):
        service, before = arena.processes["service"], arena.last
        service.end()
        service.start()
        arena.until(lambda: arena.last.session != before.session)
        arena.watch(5.0)
        assert not service.has_ended()
    assert NAME not in {one.name for one in arena.last.sources}
