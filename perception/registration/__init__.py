"""Camera motion and localization from fiducials (thesis sections 3.2.2, 3.2.5), in reading order.

- `checks`: what a registration can be made from; `RegistrationError`.
- `fiducials`: which points of a view serve as fiducials (eq. 3-21 to 3-23).
- `patch_matching`: points found again in the next view, or in another robot's view.
- `reprojection`: how known points appear to a stereo pair, with derivatives.
- `closed_form`: motion without iteration: eq. 3-18, 3-19, Kabsch, PnP.
- `likelihood`: the most likely pose and points, together.
- `motion`: all solvers behind one signature, with wrong matches left out.
- `features`: distinctive points recognised after any turn, and the motion that they give.
- `fiducial_map`: a map of fiducials with their joint covariance, and poses fitted to it.
- `target`: a target found by its markers, which gives robots a common frame (section 3.2.2).
- `cooperative`: points measured by two robots together (section 6.2 (a)).
"""
