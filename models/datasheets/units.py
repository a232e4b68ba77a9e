"""Units that the data sheets are written in."""

import math
from typing import Final

OUNCE_INCH: Final = 0.028349523125 * 9.80665 * 0.0254
"""One ounce-force inch [N m] (definition)."""
RPM: Final = 2.0 * math.pi / 60.0
"""One revolution a minute [rad/s] (definition)."""
INCH: Final = 0.0254
"""One inch [m] (definition)."""
DEGREE: Final = math.pi / 180.0
"""One degree [rad] (definition)."""
