"""roboclaw."""
