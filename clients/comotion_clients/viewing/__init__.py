"""``comotion view``: draws messages (pure), and shows what is drawn in Rerun (extra `view`)."""
