"""Stereo pairs of a plane whose texture is known everywhere, so that the truth is exact."""

import numpy as np

from tests.perception.registration.fiducial_views import HEAD


class TexturedPlane:
    """The plane n . p = d in the first camera's frame; brightness is a sum of waves on it."""

    def __init__(self, rng, normal=(0.1, -0.2, 1.0), distance=0.8, waves=80):
        self.normal = np.array(normal) / np.linalg.norm(normal)
        self.distance = distance
        # From 8 to 40 px long at 0.8 m.
        lengths = np.exp(rng.uniform(np.log(0.01), np.log(0.05), waves))
        directions = rng.uniform(0, 2 * np.pi, waves)
        self.waves = 2 * np.pi / lengths * [np.cos(directions), np.sin(directions)]
        self.phases = rng.uniform(0, 2 * np.pi, waves)

    def points(self, pixels, pose, side=0):
        """Points (N, 3) [m], first frame, that pixels (N, 2) of a camera at a pose show."""
        rays = np.column_stack(
            [
                (pixels[:, 0] - HEAD.cx) / HEAD.fx,
                (pixels[:, 1] - HEAD.cy) / HEAD.fy,
                np.ones(len(pixels)),
            ]
        )
        eye = pose.apply([side * HEAD.baseline, 0.0, 0.0])
        rays = pose.rotation.apply(rays)
        far = (self.distance - eye @ self.normal) / (rays @ self.normal)
        return eye + far[:, None] * rays

    def pair(self, pose, rng=None, noise=1.3):
        """(2, H, W) uint8 as a pair at a pose sees it."""
        columns, rows = np.meshgrid(np.arange(HEAD.width), np.arange(HEAD.height))
        pixels = np.column_stack([columns.ravel(), rows.ravel()])
        images = []
        for side in (0, 1):
            points = self.points(pixels, pose, side)[:, :2].astype(np.float32)
            grey = np.zeros(len(points), np.float32)
            for wave, phase in zip(self.waves.T.astype(np.float32), self.phases):
                grey += np.cos(points @ wave + np.float32(phase))
            grey = 120 + 6.0 * grey
            if rng is not None:
                grey += noise * rng.standard_normal(len(grey))
            images.append(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
        return np.reshape(images, (2, HEAD.height, HEAD.width))

    def image_points(self, pixels, pose):
        """Columns, rows and disparities (N, 3) [px] of what pixels (N, 2) show."""
        points = self.points(np.asarray(pixels, dtype=float), pose)
        return HEAD.project(pose.apply(points, inverse=True))
