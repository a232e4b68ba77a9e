"""Parameters that the thesis prints, true and identified (Tables 2-1 and 2-2)."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final


def _table(text: str, column: int) -> Mapping[str, float]:
    rows = (line.split() for line in text.strip().splitlines())
    return MappingProxyType({row[0]: float(row[column]) for row in rows})


_TABLE_2_1: Final = """
mass      3.0     4.021     3.655
ixx       0.15    0.123     0.144
iyy       0.10    0.054     0.089
izz       0.20    0.119     0.177
ixz       0.0     0.045     0.011
iyz       0.03    0.071     0.047
ixy       0.0     0.037     0.014
rx        0.01    0.030     0.012
ry        0.3     0.512     0.360
rz        0.1    -1.053     0.042
bx      100.0   142.554    78.362
by      100.0   139.956    75.559
bz      300.0    22.368    16.757
b_pitch 200.0    78.665   195.264
b_roll  300.0   105.061   266.254
b_yaw   400.0   133.714   333.860
kx     1000.0  1103.281   979.494
ky     1000.0  1094.529  1244.836
kz      500.0   390.469   375.479
k_pitch 2000.0  945.103  1934.569
k_roll  2500.0 1950.426  2394.257
k_yaw   3000.0 2402.537  2891.637
"""
TABLE_2_1_TRUTH: Final = _table(_TABLE_2_1, 1)
"""Thesis Table 2-1, true values: mass [kg], inertia [kg m^2], r from the base's centre of gravity
to the arm mount [m], damping [N s/m, N m s/rad], stiffness [N/m, N m/rad]."""
TABLE_2_1_CONSTANT: Final = _table(_TABLE_2_1, 2)
"""Thesis Table 2-1, estimates under the constant-parameter excitation."""
TABLE_2_1_VARIABLE: Final = _table(_TABLE_2_1, 3)
"""Thesis Table 2-1, estimates under the variable-parameter excitation."""
TABLE_2_1_AVERAGE_ERROR: Final = (108.8, 18.9)
"""Thesis Table 2-1, printed average errors, constant and variable [%]."""

_TABLE_2_2: Final = """
ixx       0.072      0.041    0.035
ry        0.054356  -0.072    0.072
rz        0.036195  -0.091    0.052
b_pitch   1.5        7.543    1.459
k_pitch 317.0      354.711  327.885
"""
TABLE_2_2_TRUTH: Final = _table(_TABLE_2_2, 1)
"""Thesis Table 2-2, values measured in the laboratory; units as in Table 2-1."""
TABLE_2_2_CONSTANT: Final = _table(_TABLE_2_2, 2)
"""Thesis Table 2-2, estimates under the constant-parameter excitation."""
TABLE_2_2_VARIABLE: Final = _table(_TABLE_2_2, 3)
"""Thesis Table 2-2, estimates under the variable-parameter excitation."""
TABLE_2_2_AVERAGE_ERROR: Final = (208.4, 26.8)
"""Thesis Table 2-2, printed average errors, constant and variable [%]."""
