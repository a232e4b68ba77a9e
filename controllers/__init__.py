"""The thesis' algorithms: observations in, commands out."""
