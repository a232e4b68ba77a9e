"""The visible shape of each body of a scene as one coloured triangle mesh."""

# trimesh types its makers in part only.
# pyright: reportUnknownMemberType=false

from typing import cast

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

_HIDDEN_GROUP = 3  # First group of the collision shapes and truth markers.
_PLANE_HALF_SIZE = 10.0  # Half the size of a plane without bounds [m].
_Geom = mujoco.mjtGeom


def body_mesh(model: mujoco.MjModel, body: int) -> tuple[trimesh.Trimesh, NDArray[np.uint8]] | None:
    """Return the visible shape of a body in its frame.

    Args:
        model: Compiled scene.
        body: Index of the body.

    Returns:
        The mesh [m] and the colours (N, 4) of its vertices; None if the body shows nothing.
    """
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    meshes: list[trimesh.Trimesh] = []
    colours: list[NDArray[np.uint8]] = []
    for geom in range(first, first + count):
        colour = geom_colour(model, geom)
        if model.geom_group[geom] >= _HIDDEN_GROUP or colour[3] == 0:
            continue
        mesh = _shape(model, geom)
        if mesh is None:
            continue
        transform = trimesh.transformations.quaternion_matrix(model.geom_quat[geom])
        transform[:3, 3] = model.geom_pos[geom]
        mesh.apply_transform(transform)
        colours.append(np.tile(colour, (len(mesh.vertices), 1)))
        meshes.append(mesh)
    if not meshes:
        return None
    return cast("trimesh.Trimesh", trimesh.util.concatenate(meshes)), np.concatenate(colours)


def geom_colour(model: mujoco.MjModel, geom: int) -> NDArray[np.uint8]:
    """Return (4,) red, green, blue, opacity; a texture counts with its mean colour."""
    material = int(model.geom_matid[geom])
    own = np.array(model.geom_rgba[geom], dtype=float)
    # MuJoCo lets a geom's own colour override its material's, when it was set.
    if material < 0 or not np.allclose(own, (0.5, 0.5, 0.5, 1.0)):
        return np.asarray(np.rint(255.0 * own), dtype=np.uint8)
    colour = np.array(model.mat_rgba[material], dtype=float)
    texture = int(model.mat_texid[material, int(mujoco.mjtTextureRole.mjTEXROLE_RGB)])
    if texture >= 0 and int(model.tex_nchannel[texture]) >= 3:
        start, channels = int(model.tex_adr[texture]), int(model.tex_nchannel[texture])
        pixels = int(model.tex_height[texture]) * int(model.tex_width[texture])
        data = np.asarray(model.tex_data[start : start + pixels * channels])
        colour[:3] *= data.reshape(-1, channels)[:, :3].mean(axis=0) / 255.0
    return np.asarray(np.rint(255.0 * colour), dtype=np.uint8)


def _shape(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Return the mesh of a geom in its frame [m]; None for other kinds."""
    kind, size = int(model.geom_type[geom]), np.array(model.geom_size[geom], dtype=float)
    solid: trimesh.Trimesh | None = None
    if kind == _Geom.mjGEOM_PLANE:
        half = np.where(size[:2] > 0.0, size[:2], _PLANE_HALF_SIZE)
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*half, 0.0]
        solid = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    elif kind == _Geom.mjGEOM_HFIELD:
        solid = _height_field(model, int(model.geom_dataid[geom]))
    elif kind == _Geom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        at, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        solid = trimesh.Trimesh(
            model.mesh_vert[at : at + count], model.mesh_face[face : face + faces], process=False
        )
    elif kind == _Geom.mjGEOM_BOX:
        solid = trimesh.creation.box(extents=2.0 * size)
        solid.unmerge_vertices()  # Edges stay sharp when no two faces share a vertex.
    elif kind == _Geom.mjGEOM_CYLINDER:
        solid = trimesh.creation.cylinder(radius=size[0], height=2.0 * size[1], sections=24)
        solid.unmerge_vertices()
    elif kind == _Geom.mjGEOM_CAPSULE:
        solid = trimesh.creation.capsule(radius=size[0], height=2.0 * size[1], count=(8, 12))
    elif kind in (_Geom.mjGEOM_SPHERE, _Geom.mjGEOM_ELLIPSOID):
        solid = trimesh.creation.icosphere(subdivisions=1)
        solid.vertices *= size[0] if kind == _Geom.mjGEOM_SPHERE else size
    return solid


def _height_field(model: mujoco.MjModel, index: int) -> trimesh.Trimesh:
    rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
    start = int(model.hfield_adr[index])
    half_x, half_y, top = (float(n) for n in model.hfield_size[index][:3])
    heights = np.asarray(model.hfield_data[start : start + rows * columns], dtype=float)
    x, y = np.meshgrid(np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows))
    vertices = np.stack([x.ravel(), y.ravel(), top * heights], axis=1)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, up = corner + 1, corner + columns
    lower = np.stack([corner, right, up + 1], axis=1)
    upper = np.stack([corner, up + 1, up], axis=1)
    return trimesh.Trimesh(vertices, np.concatenate([lower, upper]), process=False)
