"""Runs several services for one scene: etcd elects the one that speaks, the others follow and take over.

A single service needs none of it. :class:`Follower` is a part of the service's loop; what a takeover does to
ids is computed in the core, in :mod:`comotion.following`.
"""
