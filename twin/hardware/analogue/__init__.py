"""analogue."""
