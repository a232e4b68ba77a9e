"""appa."""
