"""What the robots and the field are: datasheets, MJCF, scene composition.

- `datasheets`: every number with its source.
- `rover`, `arm`, `stereo_head`, `field`: MJCF of the robot and of the ground below it.
- `as_made`: robots as made, drawn from the drawing's tolerances.
- `configuration`: what may be asked of a scene; `compose`: the scene from it.
- `mjcf`: MJCF files, read within limits.
- `terrain`, `materials`, `clutter`: ground, textures, blocks, screens and a panel with markers.
- `slope`: gravity on a field that is inclined; `ground_friction`: ground that grips here and slips
  there.
- `card_and_slot`: the card and its slot (thesis chapter 5).
- `compliant_base`: the plant of the simulation study (thesis chapter 2).
- `blocks`: the work-piece of thesis figure 4-12; `work_piece`: where its holes are.
- `truss`: two rovers with a truss segment (thesis appendix A).
- `braid`: the binary mechanism (thesis appendix E).
- `render_pictures`: the pictures of the models' README files.
- `write_scenes`: the MJCF files of what is built in Python. Each model's `scene.xml` opens in any
  MuJoCo viewer.
"""
