"""Scenes to see and touch, rovers to drive, and a twin beside one that runs.

- `view`: looks at a scene, drives its rovers and pushes what is in it.
- `drive`: a person drives any rover through the robot contract and sees what it observes.
- `live`: runs a twin beside a rover, by its log, and says what changed.
- `page_server`: the page, served on loopback alone.
"""
