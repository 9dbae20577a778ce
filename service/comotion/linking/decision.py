"""Decides to which body a hypothesis of an image is linked."""

from collections.abc import Mapping

import numpy as np

from ..arrays import Floats, Ints, Labels, ranks

# Chosen on seed 0 of the link experiment, see docs/research/linking.md.
OUTLIER_SHARE = 0.2
"""Share of a hypothesis' members that may be outliers."""
MARGIN = 6.0
"""nat; four members that fit one body only have as much."""


def body_evidence(log_likelihood: Floats) -> Floats:
    """Evidence of a hypothesis' members for each body and, last, for none of them, in nats.

    Each member is on the body, or an outlier with a probability of :data:`OUTLIER_SHARE`: a few must not
    decide.

    Parameters
    ----------
    log_likelihood
        float64 [n, K + 1]; of each member on each body and, last, on none.

    Returns
    -------
    float64 [K + 1].
    """
    best = log_likelihood.max(1, keepdims=True, initial=-np.inf)
    mixture = (1 - OUTLIER_SHARE) * np.exp(log_likelihood - best) + OUTLIER_SHARE
    return np.asarray(np.log(mixture).sum(0))


def decide(evidence: Floats, previous: int | None) -> int | None:
    """Column of the body that a hypothesis is linked to, or None.

    Motion alone decides: the body must beat every other body, a resting one among them if it moves, and
    "none of them", by :data:`MARGIN`. Where nothing moves, all bodies explain the members equally well, and
    there is no new link. A link holds until something beats it by the same margin.

    Parameters
    ----------
    evidence
        float64 [K + 1], nats; the last is for no body.
    previous
        Column that the hypothesis was linked to, None if it was not or that body is gone.
    """
    if previous is not None and evidence.max() < evidence[previous] + MARGIN:
        return previous
    best = int(evidence.argmax())
    others = np.delete(evidence, best)
    if best == len(evidence) - 1 or len(evidence) < 3 or evidence[best] < others.max() + MARGIN:
        return None
    return best


def linked_hypotheses(links: Mapping[int, int], space: Mapping[int, str]) -> dict[int, list[int]]:
    """Hypotheses in other spaces that are the same body, for each linked one; ids, ascending.

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


def representatives(labels: Labels, observed: Ints, most: int) -> Ints:
    """Members that represent their hypotheses: the `most` longest observed of each, ascending, intp [n].

    Parameters
    ----------
    labels, observed
        int64 [N], negative where undetermined; intp [N], observations of each.
    most
        Members per hypothesis.
    """
    return np.flatnonzero((labels >= 0) & (ranks(labels, -observed) < most))
