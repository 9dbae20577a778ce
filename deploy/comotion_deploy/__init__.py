"""How the processes are put together: command line, launcher, router."""
