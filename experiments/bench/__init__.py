"""Speed and accuracy, measured against a named peer in the same run.

- `bench`: the experiment ``bench``: which benchmarks, in which order; its options beside it.
- `loop`: the control loop beside bare physics.
- `mission`: CPU time of physics, drawing and perception in a mission's search.
- `identification`: our estimator beside ``mujoco.sysid``.
- `mapping`: voxel maps beside OctoMap.
- `placement`: placing a camera again within a vision period.
- `markers`: marker detectors beside OpenCV's circles (figures 5-5 to 5-10).
- `fiducials`: the markers beside ArUco and AprilTag; `tags` draws, finds and fits these,
  `image_conditions` spoils the images.
- `braid`: exact inverse kinematics beside brute force.
- `compression`: the nine predictors beside NumPy.
- `elevation_tiles`: tiles of an elevation map beside zlib, whole and damaged.
- `scaling`: how the cost grows with the size of a problem.
"""
