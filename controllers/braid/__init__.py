"""BRAID, the binary hyper-redundant arm, and its two-wire bus (Thesis appendix E)."""
