"""Insertion of a card into a slot by what the hand feels."""
