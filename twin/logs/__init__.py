"""Logs of robots, ours and others', in and out.

In reading order:

- `log`: signals with stamps, units and frames, by the actuator or sensor that they are of.
- `fields`: what a file holds: each column of numbers with its stamps. `messages` reads MCAP and
  rosbag2, `tables` CSV, LeRobot datasets and our own recordings.
- `mapping`: which field is which actuator or sensor, in which unit and frame.
- `checks`: what is wrong with a log, before anything is fitted to it.
- `writing`: logs of our own runs, and any others, as MCAP; `lerobot`: as LeRobot datasets.
- `settings`: how the robots of a log of ours were connected.
- `ticks`: such a log as its controller saw it.
"""
