"""What arrays hold, as types."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Of any shape.
Array = NDArray[np.float64]
Vector = NDArray[np.float64]
