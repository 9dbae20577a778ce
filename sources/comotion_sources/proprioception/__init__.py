"""Proprioception: the links of a robot as 6-DoF features, from its joint positions."""
