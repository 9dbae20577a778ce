"""The fusion service: the one adapter that puts the pure core on the wire."""
