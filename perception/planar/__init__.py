"""Planar maps of chapter 3, in reading order.

- `map`: a planar occupancy map (thesis section 3.2.4).
- `raycast`: range scans, and how much a view would cover.
- `information`: new information of a view in three readings (eq. 3-12b to 3-14).
"""
