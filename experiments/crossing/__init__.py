"""Crossing a field: the scene, one crossing, and the experiment over many."""
