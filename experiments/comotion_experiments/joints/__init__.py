"""The joints experiment: joints from poses alone, from features, and between bodies that have none."""
