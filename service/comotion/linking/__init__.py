"""Links between spaces: which image hypotheses and rigid bodies are one, by motion."""
