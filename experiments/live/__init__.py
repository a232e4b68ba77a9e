"""Scenes to see and touch: in MuJoCo's viewer, or on a page in the browser.

- `view`: looks at a scene, drives its rovers and pushes what is in it.
- `page_server`: the page, served on loopback alone.
"""
