"""BRAID's bodies, wires and detents in a recording for the rerun viewer."""

import rerun as rr

from experiments.appe.mechanism.bench import BraidBench
from models.datasheets import BRAID, MUSCLE_WIRE
from twin.record import body_name
from twin.scene_mesh import body_mesh


class BraidRecord:
    """Writes a bench's bodies and curves."""

    def __init__(self, stream: rr.RecordingStream, bench: BraidBench) -> None:
        """Write the meshes, and the poses of what never moves."""
        self._stream, self._bench = stream, bench
        self._moving: list[tuple[int, str]] = []
        model, data = bench.model, bench.data
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for body in range(model.nbody):
            mesh = body_mesh(model, body)
            if mesh is None:
                continue
            path = f"world/{body_name(model, body)}"
            shape = rr.Mesh3D(
                vertex_positions=mesh.vertices,
                triangle_indices=mesh.faces,
                vertex_normals=mesh.normals,
                vertex_colors=mesh.colours,
            )
            stream.log(path, shape, static=True)
            if int(model.body_weldid[body]) != 0:
                self._moving.append((body, path))
                continue
            stream.log(path, _pose(data.xpos[body], data.xquat[body]), static=True)

    def take(self, time: float) -> None:
        """Write the present state at a time [s]."""
        data = self._bench.data
        self._stream.set_time("sim_time", duration=time)
        for body, path in self._moving:
            self._stream.log(path, _pose(data.xpos[body], data.xquat[body]))
        hot = MUSCLE_WIRE.ambient + data.act[self._bench.model.actuator_actadr[self._bench.wires]]
        self._stream.log("curves/hottest_wire", rr.Scalars(float(hot.max())))
        travel = (self._bench.travel() / BRAID.half_stroke).ravel()
        self._stream.log("curves/legs", rr.Scalars(travel))


def _pose(position, quaternion) -> rr.Transform3D:
    w, x, y, z = quaternion
    return rr.Transform3D(translation=position, quaternion=rr.Quaternion(xyzw=[x, y, z, w]))
