"""The core offline: evaluate recordings and reproduce the paper."""
