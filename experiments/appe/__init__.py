"""appe."""
