"""The simplified plant of chapter 2: a rigid arm on a rigid base on a 6-DOF compliance."""
