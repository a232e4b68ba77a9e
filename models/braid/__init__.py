"""The computer card and the slot that it is inserted into."""
