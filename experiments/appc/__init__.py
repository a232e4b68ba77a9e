"""Compression of pictures, and their information for the choice of views (appendix C).

- `compression`: the experiment ``appc-compression``: Table C-1, figure C-2 and metrics.
- `pictures`: the pictures, and their compression ratios.
- `views`: measures of a picture compared with the true gain of its view.
- `figures`: the figures.
"""
