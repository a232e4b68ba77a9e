"""Frustum culling: leaves out of a scene what a camera does not see, before the driver gets it."""

from typing import Any

import mujoco
import numpy as np


def cull(scene: Any, model: mujoco.MjModel, data: mujoco.MjData, aspect: float) -> None:
    """Take the geoms that lie wholly outside the view frustum out of a scene.

    The driver would work through their faces and throw them away; the image is the same.

    Args:
        scene: Scene made by `mujoco.mjv_updateScene`; the type of the culled geoms becomes none.
        model: Compiled scene.
        data: State of the scene.
        aspect: Columns over rows of the image, for a camera that is given by its field of view.
    """
    eye = scene.camera[0]
    # MuJoCo keeps two eyes, the camera's own distance apart; the image is that from between them.
    middle = 0.5 * (np.array(eye.pos, dtype=float) + np.array(scene.camera[1].pos, dtype=float))
    forward, up = np.array(eye.forward, dtype=float), np.array(eye.up, dtype=float)
    to_camera = np.column_stack([np.cross(forward, up), up, forward])
    across, above, ahead = ((data.geom_xpos - middle) @ to_camera).T
    half = eye.frustum_width or 0.5 * aspect * (eye.frustum_top - eye.frustum_bottom)
    radius = model.geom_rbound
    unseen = ahead < -radius
    for offset, low, high in (
        (across, eye.frustum_center - half, eye.frustum_center + half),
        (above, eye.frustum_bottom, eye.frustum_top),
    ):
        # Distances from the two planes through the camera and the image's edges.
        for slope, side in ((low / eye.frustum_near, -1.0), (high / eye.frustum_near, 1.0)):
            unseen |= side * (offset - slope * ahead) > radius * np.hypot(1.0, slope)
    # A plane has no end, and no radius.
    unseen &= radius > 0.0
    nothing, geom = int(mujoco.mjtGeom.mjGEOM_NONE), int(mujoco.mjtObj.mjOBJ_GEOM)
    for drawn in scene.geoms[: scene.ngeom]:
        if drawn.objtype == geom and unseen[drawn.objid]:
            drawn.type = nothing
