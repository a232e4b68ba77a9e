"""Robots that nobody is told, identified and scored against the truth."""
