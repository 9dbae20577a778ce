"""Names for the arrays that the core passes on; shapes and units stand where they are used."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Stamps = NDArray[np.int64]
"""Nanoseconds since the Unix epoch."""
Slots = NDArray[np.intp]
"""Where trajectories are stored in a window."""
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]
Labels = NDArray[np.int64]
"""A hypothesis id per trajectory, or -1."""
