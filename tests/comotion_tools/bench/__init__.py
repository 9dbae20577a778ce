"""``comotion dev bench``: what an update costs, in the core and in processes over a router."""
