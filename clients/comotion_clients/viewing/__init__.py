"""``comotion view``: a scene as shapes (pure), and what shows them (Rerun, the extra `view`)."""
