"""Deployment: the command line, the launcher of several processes, and the router."""
