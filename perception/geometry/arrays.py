"""Names for arrays of one element type, for annotations."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
IndexArray = NDArray[np.intp]
ImageArray = NDArray[np.uint8]
ByteArray = NDArray[np.uint8]
