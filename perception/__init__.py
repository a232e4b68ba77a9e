"""Images and points to geometry: NumPy, SciPy, OpenCV, Pillow and numba; nothing else of ours.

- `geometry`: rigid motions, pinhole cameras, gravity, limits of files; every room may import it.
- `stereo`: a rectified pair to points with covariance (thesis section 3.2.3).
- `registration`: camera motion and localization from fiducials (sections 3.2.2, 3.2.5, 6.2 (a)).
- `voxels`: maps of space, and the expected information of views (section 3.2.4 in 3-D).
- `elevation`: height of the ground by cells, and what stands on it.
- `planar`: planar maps of chapter 3, and the expected information of views (section 3.2.4).
- `markers`: disc markers of card and slot, and their bodies' poses (sections 5.1 to 5.3).
- `compression`: lossless compression, and the information that an image holds (appendix C).
"""

from perception.geometry.kernel_cache import ensure_kernel_cache

# Before any kernel is declared: every module with kernels imports something of this package.
ensure_kernel_cache()
