"""Where to look next: planar robots, and stereo heads on arms."""
