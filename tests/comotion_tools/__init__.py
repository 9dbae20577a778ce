"""Tools for those who change comotion, which ``comotion dev`` starts; they are in a checkout alone."""
