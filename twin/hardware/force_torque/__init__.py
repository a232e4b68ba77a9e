"""The force/torque sensor under the arm.

- `net_ft`: client of an ATI Net F/T over UDP.
"""
