"""Camera calibration: models, and the files that hold them."""
