"""The arm and its yielding base in motion (Thesis appendix A)."""
