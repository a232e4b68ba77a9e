"""Scenes to see and touch, and rovers to drive: in MuJoCo's viewer, or on a page in the browser.

- `view`: looks at a scene, drives its rovers and pushes what is in it.
- `drive`: a person drives any rover through the robot contract and sees what it observes.
- `page_server`: the page, served on loopback alone.
"""
