"""Where to put a camera for a task (thesis chapter 4)."""
