"""Boards that behave as their makers document, with the physics of the twin behind them."""
