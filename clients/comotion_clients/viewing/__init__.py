"""``comotion view``: messages -> shapes (pure), and shapes -> Rerun (extra `view`)."""
