"""Control of the arm on a yielding base (appendix A).

- `control`: control laws on soft, middle and stiff bases (sections A.1 and A.2).
- `tipover`: guards against tipping over (section A.3).
- `truss`: two rovers insert a segment in a truss stage (section A.4).
"""
