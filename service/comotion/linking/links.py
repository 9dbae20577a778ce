"""Which image hypothesis is which body: evidence of its members, and how long a link holds."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats

# Share of a hypothesis' members that may be anything: strays must not decide.
STRAYS = 0.2
# nat; by so much a body must explain the members better than anything else to be linked, and
# anything else than the body, to be let go: four members that speak clearly.
MARGIN = 6.0


def evidence(log_likelihood: Floats) -> Floats:
    """Evidence of members [n, K + 1] for each body and, last, for none of them, in nats, float64 [K + 1].

    Each member is on the body, or a stray with a probability of :data:`STRAYS`.
    """
    best = log_likelihood.max(1, keepdims=True, initial=-np.inf)
    return np.asarray(np.log((1 - STRAYS) * np.exp(log_likelihood - best) + STRAYS).sum(0))


def decide(found: Floats, before: int | None) -> int | None:
    """Column of the body that a hypothesis is linked to, or None.

    Motion alone decides: the body must beat every other body, one that moves against one that does not
    among them, and none of them, by :data:`MARGIN`. Where nothing moves, all bodies there are explain
    as much. A link holds until something beats it by as much.

    Parameters
    ----------
    found
        float64 [K + 1], evidence; the last is for no body.
    before
        Column that it was linked to, None if it was not or that body is gone.
    """
    if before is not None and found.max() < found[before] + MARGIN:
        return before
    best = int(found.argmax())
    others = np.delete(found, best)
    if best == len(found) - 1 or len(found) < 3 or found[best] < others.max() + MARGIN:
        return None
    return best


def joined(links: Mapping[int, int], space: Mapping[int, str]) -> dict[int, list[int]]:
    """Hypotheses in other spaces that are the same body: of each linked one, ascending.

    Parameters
    ----------
    links
        Image hypothesis -> body, both by id; the hypotheses of several cameras may have one body.
    space
        Name of the space of each hypothesis.
    """
    bodies: dict[int, list[int]] = {}
    for image, body in links.items():
        bodies.setdefault(body, [body]).append(image)
    return {
        one: sorted(other for other in group if space[other] != space[one])
        for group in bodies.values()
        for one in group
    }


def speakers(labels: NDArray[np.int64], observed: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Members that speak for their hypotheses: the `most` longest observed of each, ascending, intp [n].

    Parameters
    ----------
    labels, observed
        int64 [N], negative where undetermined; intp [N], observations of each.
    """
    order = np.argsort(-observed, kind="stable")
    order = order[labels[order] >= 0]
    chosen = [order[labels[order] == label][:most] for label in np.unique(labels[order]).tolist()]
    return np.sort(np.concatenate(chosen)) if chosen else np.zeros(0, np.intp)
