"""BRAID's bodies, wires and detents in a recording for the rerun viewer."""

import rerun as rr

from experiments.appe.mechanism.bench import BraidBench
from models.datasheets import BRAID, MUSCLE_WIRE
from twin.record import body_transform, log_meshes


class BraidRecord:
    """Writes a bench's bodies and curves."""

    def __init__(self, stream: rr.RecordingStream, bench: BraidBench) -> None:
        """Write the meshes, and the poses of what never moves."""
        self._stream, self._bench = stream, bench
        self._moving = log_meshes(stream, bench.model, bench.data)

    def take(self, time: float) -> None:
        """Write the present state at a time [s]."""
        data = self._bench.data
        self._stream.set_time("sim_time", duration=time)
        for path, pose in self._moving.items():
            self._stream.log(path, body_transform(*pose))
        hot = MUSCLE_WIRE.ambient + data.act[self._bench.model.actuator_actadr[self._bench.wires]]
        self._stream.log("curves/hottest_wire", rr.Scalars(float(hot.max())))
        travel = (self._bench.travel() / BRAID.half_stroke).ravel()
        self._stream.log("curves/legs", rr.Scalars(travel))
