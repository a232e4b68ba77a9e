"""The visible shape of each body of a scene as one coloured triangle mesh."""

# trimesh types its makers in part only.
# pyright: reportUnknownMemberType=false

import dataclasses

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray

_HIDDEN_GROUP = 3  # Collision shapes and truth markers stand in groups from here on.
_PLANE_HALF_SIZE = 10.0  # Of a plane without bounds [m]
_Geom = mujoco.mjtGeom


@dataclasses.dataclass(frozen=True)
class BodyMesh:
    """Triangles in a body's frame.

    Attributes:
        vertices: (N, 3) [m].
        faces: (M, 3) vertex indices.
        colours: (N, 4) uint8.
    """

    vertices: FloatArray
    faces: NDArray[np.int64]
    colours: NDArray[np.uint8]

    @property
    def normals(self) -> FloatArray:
        """(N, 3) unit normals, averaged over the faces of each vertex."""
        corners = self.vertices[self.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.zeros_like(self.vertices)
        for corner in range(3):
            np.add.at(normals, self.faces[:, corner], across)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return normals / np.maximum(length, 1e-12)


def body_mesh(model: mujoco.MjModel, body: int) -> BodyMesh | None:
    """Return what one sees of a body, or None if it shows nothing.

    Args:
        model: The scene.
        body: Index of the body.
    """
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    vertices: list[FloatArray] = []
    faces: list[NDArray[np.int64]] = []
    colours: list[NDArray[np.uint8]] = []
    total = 0
    for geom in range(first, first + count):
        colour = geom_colour(model, geom)
        if model.geom_group[geom] >= _HIDDEN_GROUP or colour[3] == 0:
            continue
        shape = _shape(model, geom)
        if shape is None:
            continue
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        vertices.append(shape[0] @ rotation.reshape(3, 3).T + model.geom_pos[geom])
        faces.append(shape[1] + total)
        colours.append(np.tile(colour, (len(shape[0]), 1)))
        total += len(shape[0])
    if not vertices:
        return None
    return BodyMesh(np.concatenate(vertices), np.concatenate(faces), np.concatenate(colours))


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


def _shape(model: mujoco.MjModel, geom: int) -> tuple[FloatArray, NDArray[np.int64]] | None:
    """Return vertices (N, 3) [m] and faces (M, 3) in the geom's frame; None for other kinds."""
    kind = int(model.geom_type[geom])
    size = np.array(model.geom_size[geom], dtype=float)
    if kind == _Geom.mjGEOM_PLANE:
        half = np.where(size[:2] > 0.0, size[:2], _PLANE_HALF_SIZE)
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*half, 0.0]
        return corners, np.array([[0, 1, 2], [0, 2, 3]])
    if kind == _Geom.mjGEOM_HFIELD:
        return _height_field(model, int(model.geom_dataid[geom]))
    if kind == _Geom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        at, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        vertices = np.array(model.mesh_vert[at : at + count], dtype=float)
        return vertices, np.array(model.mesh_face[face : face + faces], dtype=np.int64)
    solid = _solid(kind, size)
    if solid is None:
        return None
    if kind in (_Geom.mjGEOM_BOX, _Geom.mjGEOM_CYLINDER):
        solid.unmerge_vertices()  # Edges stay sharp when no two faces share a vertex.
    return np.asarray(solid.vertices, dtype=float), np.asarray(solid.faces, dtype=np.int64)


def _solid(kind: int, size: FloatArray) -> trimesh.Trimesh | None:
    if kind == _Geom.mjGEOM_BOX:
        return trimesh.creation.box(extents=2.0 * size)
    if kind == _Geom.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(radius=size[0], height=2.0 * size[1], sections=24)
    if kind == _Geom.mjGEOM_CAPSULE:
        return trimesh.creation.capsule(radius=size[0], height=2.0 * size[1], count=(8, 12))
    if kind in (_Geom.mjGEOM_SPHERE, _Geom.mjGEOM_ELLIPSOID):
        ball = trimesh.creation.icosphere(subdivisions=1)
        ball.vertices *= size[0] if kind == _Geom.mjGEOM_SPHERE else size
        return ball
    return None


def _height_field(model: mujoco.MjModel, index: int) -> tuple[FloatArray, NDArray[np.int64]]:
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
    return vertices, np.concatenate([lower, upper])
