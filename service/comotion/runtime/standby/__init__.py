"""Several services for one scene: etcd elects who speaks, the others follow and take over.

A service alone needs none of it. :mod:`.follower` is a part of the service's loop; what a takeover does to
ids is pure, in :mod:`comotion.following`.
"""

from .election import DEFAULT_LEASE_S, Election
from .etcd import Entry, Etcd, EtcdUnavailableError

__all__ = ["DEFAULT_LEASE_S", "Election", "Entry", "Etcd", "EtcdUnavailableError"]
