"""BRAID, the binary arm (appendix E).

- `arm`: its workspace and inverse kinematics (section E.3, figure E-5).
- `mechanism`: the arm in physics (figures E-1, E-2, E-9).
- `placement`: a camera placed by BRAID on a rover (with chapter 4).
- `bus`: pulses on its power line (figures E-7, E-8).
"""
