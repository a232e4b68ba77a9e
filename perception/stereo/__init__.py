"""A stereo pair to points with covariance (thesis section 3.2.3), in reading order.

- `geometry`: triangulation, projection and covariance of a rectified pair (eq. 3-1 to 3-6).
- `matching`: dense points of a pair by block matching, refined.
- `refinement`: sub-pixel disparities by least squares on windows of both images.
- `eye_turn`: how one eye is turned against the other.
- `patch_fit`: one patch fitted to another image, with affine distortion.
"""
