"""The KLT camera source: a pure feature tracker, and the process that runs it on a camera."""
