"""A robot identifies its own dynamics by swinging its arm (Thesis chapter 2, appendix B)."""
