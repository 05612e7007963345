"""The array types of planning and control, for modules that import numpy anyway: the CAN loop's process does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
