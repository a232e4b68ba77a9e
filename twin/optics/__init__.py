"""What lenses, shutters and mountings make of a rendered image.

In reading order:

- `realism`: how far a stereo head as made departs from the drawing; sets by name.
- `flow`: motion of the image and circles of confusion, from depths and velocities.
- `blur`: defocus and motion blur with one point-spread function for each block of pixels.
- `formation`: all steps from the rendered image to the light on the sensor.
"""
