"""Sources: the simulator, cameras, proprioception and replay publish observations of a scene."""
