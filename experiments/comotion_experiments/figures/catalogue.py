"""Catalogue of the figures of the thesis that show results, and their selection."""

from collections.abc import Sequence

from comotion_schemas.errors import KnownError

from . import affinity, clusters, simulated, workcell
from .study import Figure

FIGURES = (
    Figure(
        "3.3",
        "Affinities of objects that start one after another",
        "Four objects move from left to right at one speed, each starting a second after the one below "
        "it; R is the background. Rows 1 and 3: the scene; rows 2 and 4: affinities of the trajectories "
        "sorted by object (blue: 1, red: 0). Some pairs of different objects keep a high affinity in "
        "the thesis method. The default method's affinity is the probability that two trajectories "
        "belong to one body.",
        affinity.draw_starts,
    ),
    Figure(
        "3.4",
        "Choosing the number of clusters by BIC",
        "Bayesian information criterion of Gaussian mixtures on the affinities of figure 3.3, by number "
        "of components and kind of covariance. The thesis rejects it: the minimum (star) suggests more "
        "clusters than there are.",
        clusters.draw_bic,
    ),
    Figure(
        "3.5",
        "Choosing the number of clusters by the eigengap",
        "The first ten eigenvalues of the graph Laplacian L = D − A (above) and L_norm = I − D⁻¹A "
        "(below) of figure 3.3, mean and range over seeds. After the dotted line there ought to be a "
        "gap; the thesis rejects the eigengap because the transition is smooth.",
        clusters.draw_eigenvalues,
    ),
    Figure(
        "3.6",
        "Affinity depends on the direction of motion",
        "Only B moves, downwards; there is no noise. To the thesis method its distance to Y, along the "
        "motion, changes at once and that to G, across it, hardly at all: B might turn about G.",
        affinity.draw_direction,
    ),
    Figure(
        "4.1",
        "The effect of γ",
        "An object crosses a noisy background. A row per standard deviation σ at which the affinity is "
        "0.5, from one hypothesis per trajectory to an object found late; right: the affinities at t = "
        "5 s. The last row is the default method, which has no σ to choose. Of the five σ the thesis "
        "names 0.02 alone; the others are chosen so that the rows show what it says of them.",
        simulated.draw_switches,
    ),
    Figure(
        "4.2",
        "The effect of γ over time",
        "NMI of figure 4.1. The best choice is σ = 0.02, twice the largest noise.",
        simulated.draw_switch_curves,
    ),
    Figure(
        "4.3",
        "Weights by velocity",
        "The object rests for 10 s and then crosses the scene at 0.3 per second. Weights by velocity "
        "make the thesis method see it sooner; a small threshold v is no different from equal weights.",
        simulated.draw_weights,
    ),
    Figure(
        "4.4",
        "Translation, rotation and new features",
        "G moves to the left and spins about its centre in changing directions, P turns by 90 degrees, "
        "and every 2 s 20 % of the features of each object are replaced. At t = 2.2, 4.2 and 6.2 s "
        "there are newborn features: the thesis method tends to put them into the background.",
        simulated.draw_respawning,
    ),
    Figure(
        "4.5",
        "New features over time",
        "NMI of figure 4.4. It drops when features are replaced and slowly comes back.",
        simulated.draw_respawning_curves,
    ),
    Figure(
        "4.6",
        "A toy truck is pulled",
        "Features of a KLT tracker in a rendered RGB-D camera, coloured by hypothesis. A gripper in "
        "place of the hand pulls the truck to the left, then pushes it back. The thesis method has "
        "the σ that suits the scene best; the third row is the truth.",
        workcell.pictures(workcell.TRUCK),
        workcell=True,
    ),
    Figure(
        "4.7",
        "Truck and tower move against each other",
        "As figure 4.6, with two objects that move at the same time and half as many looks for new features.",
        workcell.pictures(workcell.TOWER),
        workcell=True,
    ),
    Figure(
        "4.8",
        "A door turns and a drawer slides",
        "The door opens, so far that all its features are lost, and closes; then the drawer goes out "
        "and in. In the thesis the door has another hypothesis when it closes.",
        workcell.pictures(workcell.SHELF),
        workcell=True,
    ),
    Figure(
        "4.9",
        "The toy truck over time",
        "NMI of the scene of figure 4.6 for several σ.",
        workcell.curves(workcell.TRUCK),
        workcell=True,
    ),
    Figure(
        "4.10",
        "Truck and tower over time",
        "NMI of the scene of figure 4.7 for several σ.",
        workcell.curves(workcell.TOWER),
        workcell=True,
    ),
    Figure(
        "4.11",
        "Door and drawer over time",
        "NMI of the scene of figure 4.8 for several σ.",
        workcell.curves(workcell.SHELF),
        workcell=True,
    ),
)


def select(names: Sequence[str] | None) -> list[Figure]:
    """Select figures by their numbers.

    Parameters
    ----------
    names
        Numbers, each entry one or several separated by commas; None: all figures.

    Raises
    ------
    ValueError
        If there is no such figure.
    """
    if names is None:
        return list(FIGURES)
    wanted = [part.strip() for name in names for part in name.split(",")]
    known = [figure.name for figure in FIGURES]
    for name in wanted:
        if name not in known:
            raise KnownError(f"no figure {name!r}; one of {', '.join(known)}")
    return [figure for figure in FIGURES if figure.name in wanted]
