"""Lossless compression of images (thesis appendix C), in reading order.

- `image_codec`: the ten methods of table C-1, and the information that an image holds.
- `image_predictors`: pixels predicted from their neighbours, methods 1 to 9.
- `entropy_coding`: entropy, and Huffman's code.
- `sequence_coding`: run lengths and LZW.
"""
