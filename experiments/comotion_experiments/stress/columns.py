"""The metrics of a run by name, as columns of tables; NaN where one does not apply."""

from ..tables import Column

SCENE_COLUMNS = (
    # Mean NMI over all updates, with bodies as one until they have moved apart by five sigma.
    Column("nmi_apart", "NMI", 3),
    # From a second after all bodies are apart.
    Column("all_bodies", "all bodies", 3),
    # Against the true bodies.
    Column("nmi", "by body", 3),
    # s from apart to a hypothesis of its own, mean over bodies.
    Column("delay", "delay", 2),
    # s after an event until right again, mean over events; share of events with at most 1 s.
    Column("healing", "healing", 2),
    Column("healed_in_1s", "in 1 s", 2),
    # Share of bodies with the same id before and after an event.
    Column("kept", "kept", 2),
    # 1 where the mean NMI (apart) from 5 s after the first update on is below .95.
    Column("wrong", "wrong", 2),
    # Ids an object over the run.
    Column("ids", "ids", 2),
    # Events a minute beyond the true ones; true events a minute.
    Column("spurious", "spurious", 1),
    Column("true", "true", 1),
    # Tracks with another hypothesis than an update before, per 100.
    Column("switches", "switches", 1),
    # Mean numbers: confirmed hypotheses, and bodies apart; share of the updates with more of the former.
    Column("hypotheses", "K", 2),
    Column("bodies", "K true", 2),
    Column("over", "over", 2),
    # Median time of an update.
    Column("ms", "ms", 1),
)
# The terminal and the JSON have all metrics, the page those that most others follow from.
PAGE_COLUMNS = (
    Column("nmi_apart", "NMI", 3),
    Column("delay", "delay, s", 2),
    Column("healing", "healing, s", 1),
    Column("kept", "kept", 2),
    Column("ids", "ids", 1),
    Column("spurious", "spurious", 0),
)
IMAGE_COLUMNS = (
    # Misclassified features; undetermined ones are wrong.
    Column("error", "error, %", 1),
    # Share of sequences with the right number of objects, with more, with fewer.
    Column("exact", "K exact, %", 0, 100.0),
    Column("over", "K over, %", 0, 100.0),
    Column("under", "K under, %", 0, 100.0),
    Column("nmi", "NMI", 3),
    # Error of spectral clustering of shape interaction, with K given, and of one object for all.
    Column("given", "K given, %", 1),
    Column("one", "one, %", 1),
)
