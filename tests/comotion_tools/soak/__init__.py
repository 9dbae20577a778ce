"""``comotion dev soak``: a scene under mixed load and faults, watched for what must always hold."""
