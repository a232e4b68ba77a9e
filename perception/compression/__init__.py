"""Lossless compression of images (thesis appendix C), in reading order.

- `image_codec`: the ten methods of table C-1, and the information that an image holds.
- `image_predictors`: pixels predicted from their neighbours, methods 1 to 9.
- `byte_codes`: entropy, and the codes of bytes: Huffman's, run lengths, LZW.
"""
