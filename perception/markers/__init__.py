"""Disc markers of card and slot (thesis sections 5.1 to 5.3), in reading order.

- `ellipses`: discs as cameras see them, and regions measured as ellipses.
- `hough`: the thesis' detector, by the tracking Hough transform (eq. 5-5 to 5-9).
- `blobs`: a detector of today, whose ellipses are fitted to the grey levels.
- `poses`: a body's pose from the ellipses of its markers.
- `detector_names`: names of both detectors.
- `bodies`: markers of a stereo pair, matched with the bodies that carry them.
"""
