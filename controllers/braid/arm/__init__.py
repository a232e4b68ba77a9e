"""Kinematics of the binary arm (Thesis sections E.2 and E.3), in reading order.

- `stage`, `thesis_stage`: one stage exactly, and by the thesis' repaired equations.
- `flexure`: hinges and how far they bend. `chain`: words and poses of many stages.
- `obstacles`: which words keep clear. `pose_tree`: nearest pose of many.
- `heuristics`, `meeting`, `lattice_walk`: searches for a word.
- `inverse`: all searches behind one signature.
"""
