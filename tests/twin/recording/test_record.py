import atexit
import ctypes.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from models.compose import ROUGH, RobotPlacement, make_model
from models.datasheets import ARM
from tests.twin.scene import SERVO, compile_scene
from twin.camera import StereoConfig
from twin.connect import connect
from twin.loop import LoopRecorder, Tick, run
from twin.recording.record import Recorder, _wait_for, screenshot
from twin.recording.scene_mesh import body_mesh, geom_colour
from twin.robot import ArmMode, Command, WheelMode
from twin.sensors import DATASHEET
from twin.simulation import Simulation

ROOT = Path(__file__).parents[3]


class Drive:
    """Drives slowly, and views the ground ahead."""

    arm = np.array(ARM.home) + [0.0, 0.4, -0.4, -0.8]
    speed = 1.0

    def __init__(self, recorder=None):
        self.recorder = recorder

    def reset(self):
        pass

    def step(self, observations):
        if self.recorder is not None:
            now = observations["rover1"].time
            self.recorder.log_scalars("excitation/omega", [now, 2 * now], ["x", "y"])
            self.recorder.log_band("estimates/mass", 3.0, 2.0, 4.0, ["mass"])
        return {
            "rover1": Command(np.full(4, self.speed), self.arm, WheelMode.SPEED, ArmMode.POSITION)
        }


def small(stereo=None):
    return Simulation(
        compile_scene(), ["rover1"], suite=DATASHEET, servo=SERVO, stereo=stereo, seed=1
    )


def columns(path):
    """Per entity, the number of rows and the values of each component over the recording."""
    rows: dict[str, dict[str, list]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        entity = rows.setdefault(str(chunk.entity_path), {})
        for name in batch.schema.names:
            entity.setdefault(name, []).extend(batch.column(name).to_pylist())
    return rows


class Truth(LoopRecorder):
    """Keeps where the rover is and what its left eye has seen last."""

    def __init__(self, simulation):
        self.simulation, self.places, self.images = simulation, {}, {}

    def record(self, tick):
        chassis = self.simulation.data.body("rover1/chassis")
        self.places[round(tick.time, 3)] = np.concatenate([chassis.xpos, chassis.xquat])
        pair = tick.observations["rover1"].stereo.value
        if pair is not None:
            self.images[round(tick.time, 3)] = np.array(pair[0])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A run of a second, its recording's rows, and what truly was."""
    path = tmp_path_factory.mktemp("run") / "deep" / "run.rrd"
    simulation = small(StereoConfig(10.0))
    truth = Truth(simulation)
    with Recorder(path, simulation.robots, simulation) as recorder:
        run(simulation.robots, [Drive(recorder)], simulation, [recorder, truth], 1.0)
    return path, truth, columns(path)


def test_recording_holds_bodies_sensors_commands_images_and_estimates(recorded):
    _, _, rows = recorded
    for entity in ("rover1/duty/wheels", "rover1/duty/arm", "excitation/omega"):
        assert len(rows[f"/{entity}"]["sim_time"]) == 100
    assert len(rows["/rover1/sensors/gyro"]["sim_time"]) == 100
    assert len(rows["/rover1/sensors/inclinometer"]["sim_time"]) == 25
    assert len(rows["/world/rover1/chassis"]["Transform3D:translation"]) == 25
    for part, value in (("mean", 3.0), ("low", 2.0), ("high", 4.0)):
        values = rows[f"/estimates/mass/{part}"]["Scalars:scalars"]
        assert [v for v in values if v is not None] == [[value]] * 100


def test_recorded_poses_move_as_the_rover_did(recorded):
    _, truth, rows = recorded
    chassis = rows["/world/rover1/chassis"]
    poses = zip(
        chassis["sim_time"],
        chassis["Transform3D:translation"],
        chassis["Transform3D:quaternion"],
        strict=True,
    )
    places = []
    for time_, place, turn in poses:
        true = truth.places[round(time_.total_seconds(), 3)]
        np.testing.assert_allclose(place[0], true[:3], atol=1e-5)
        np.testing.assert_allclose(np.roll(turn[0], 1), true[3:], atol=1e-5)
        places.append(place[0])
    # A radian a second on wheels of 5 cm.
    assert 0.03 < np.linalg.norm(np.subtract(places[-1], places[0])[:2]) < 0.06


def test_recorded_images_are_what_the_eye_saw(recorded):
    _, truth, rows = recorded
    left = rows["/rover1/stereo/left"]
    for time_, blob in zip(left["sim_time"], left["EncodedImage:blob"], strict=True):
        shown = cv2.imdecode(np.array(blob[0], np.uint8), cv2.IMREAD_GRAYSCALE)
        seen = truth.images[round(time_.total_seconds(), 3)]
        # JPEG blurs a ground of noise; of other pictures there is nothing in it.
        assert np.corrcoef(shown.ravel(), seen.ravel())[0, 1] > 0.7
        assert abs(np.corrcoef(shown.ravel(), seen[::-1].ravel())[0, 1]) < 0.5


def test_images_are_throttled_to_the_recorders_rate(recorded):
    _, _, rows = recorded
    images = rows["/rover1/stereo/left"]["EncodedImage:blob"]
    assert len([image for image in images if image]) == 4


def test_pairs_that_nobody_has_read_are_drawn_only_if_asked_for(tmp_path):
    class Looking(Drive):
        def step(self, observations):
            seen = observations["rover1"]
            if seen.time > 0.555 and seen.stereo.usable:
                assert seen.stereo.value.any()
            return super().step(observations)

    simulation = small(StereoConfig(10.0))
    with Recorder(tmp_path / "run.rrd", simulation.robots, simulation, draws=False) as recorder:
        run(simulation.robots, [Looking()], simulation, [recorder], 0.7)
    images = columns(tmp_path / "run.rrd")["/rover1/stereo/left"]
    assert min(time_.total_seconds() for time_ in images["sim_time"]) > 0.555
    assert len([image for image in images["EncodedImage:blob"] if image]) == 1


def test_line_is_recorded_with_its_points_and_goes_when_there_is_none(tmp_path):
    path = np.array([[0.0, 0.0, 0.1], [0.5, 1.0, 0.1]])
    with Recorder(tmp_path / "run.rrd") as recorder:
        recorder.log_line("map/path", path)
        recorder.log_line("map/path", path[:0])
    strips = columns(tmp_path / "run.rrd")["/map/path"]["LineStrips3D:strips"]
    np.testing.assert_allclose(strips[0], [path])
    assert strips[1] == []


def test_meshes_are_written_once_and_never_again(recorded):
    _, _, rows = recorded
    meshes = rows["/world/rover1/chassis"]["Mesh3D:vertex_positions"]
    assert len([mesh for mesh in meshes if mesh]) == 1


def test_both_timelines_count_together(recorded):
    _, _, rows = recorded
    steps = [s for s in rows["/rover1/duty/arm"]["step"] if s is not None]
    assert steps == list(range(100))


def test_recorded_poses_are_those_of_the_simulation(tmp_path):
    simulation = small()
    with Recorder(tmp_path / "run.rrd", simulation.robots, simulation) as recorder:
        recorder.record(Tick(0, simulation.time, {}, {}))
    rows = columns(tmp_path / "run.rrd")["/world/rover1/shoulder"]
    body = simulation.model.body("rover1/shoulder").id
    np.testing.assert_allclose(
        rows["Transform3D:translation"][-1][0], simulation.data.xpos[body], atol=1e-6
    )
    quaternion = np.array(rows["Transform3D:quaternion"][-1][0])
    np.testing.assert_allclose(np.roll(quaternion, 1), simulation.data.xquat[body], atol=1e-6)


def test_missing_channels_leave_no_curve(tmp_path):
    simulation = small()
    simulation.robots["rover1"].sensors.disconnect("gyro")
    for _ in range(2):
        simulation.tick()
    with Recorder(tmp_path / "run.rrd", simulation.robots, simulation) as recorder:
        observations = {"rover1": simulation.robots["rover1"].observe()}
        recorder.record(Tick(0, simulation.time, observations, {}))
    rows = columns(tmp_path / "run.rrd")
    assert "/rover1/sensors/gyro" not in rows and "/rover1/sensors/heading" in rows


def test_curve_may_not_change_its_width(tmp_path):
    with Recorder(tmp_path / "run.rrd") as recorder:
        recorder.log_scalars("a", [1.0, 2.0])
        with pytest.raises(ValueError, match="curve 'a' has 2 values, got 3"):
            recorder.log_scalars("a", [1.0, 2.0, 3.0])


KILLED = """
import sys, time
from tests.twin.recording.test_record import Drive, Recorder, run, small
simulation = small()
recorder = Recorder(sys.argv[1], simulation.robots, simulation)
run(simulation.robots, [Drive(recorder)], simulation, [recorder], 1.0)
print("flushed", flush=True)
time.sleep(60)
"""


def test_killed_run_loses_nothing_that_was_flushed(tmp_path):
    path = tmp_path / "run.rrd"
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "flushed\n"
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    rows = columns(path)
    assert len(rows["/rover1/duty/arm"]["sim_time"]) == 100


def test_body_mesh_spans_the_geom_that_it_shows():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="box" size="1 2 3" pos="5 0 0" rgba="1 0 0 1"/>'
        '<geom type="sphere" size="9" group="3"/></worldbody></mujoco>'
    )
    mesh, colours = body_mesh(model, 0)
    np.testing.assert_array_equal(colours, np.tile([255, 0, 0, 255], (len(mesh.vertices), 1)))
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [4, -2, -3])
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [6, 2, 3])
    np.testing.assert_allclose(np.linalg.norm(mesh.vertex_normals, axis=1), 1.0)
    np.testing.assert_array_equal(geom_colour(model, 0), [255, 0, 0, 255])


def test_height_field_mesh_lies_on_the_physical_ground():
    model = make_model(ROUGH, (RobotPlacement(),))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    ground = model.geom("ground").id
    rocks = [g for g in range(model.ngeom) if model.geom(g).name.startswith("rock")]
    model.geom_rgba[rocks, 3] = 0.0
    model.geom_matid[rocks] = -1
    mesh, _ = body_mesh(model, 0)
    for vertex in mesh.vertices[(np.abs(mesh.vertices[:, :2]) < 2.5).all(axis=1)][::200]:
        above = vertex + [1e-4, 1e-4, 1.0]
        hit = mujoco.mj_rayHfield(model, data, ground, above, np.array([0.0, 0.0, -1.0]))
        distance = hit[0] if isinstance(hit, tuple) else hit
        assert distance == pytest.approx(1.0, abs=2e-3)


@pytest.mark.slow
def test_recordings_with_stereo_on_rough_ground_stay_below_a_megabyte_a_second(tmp_path):
    path = tmp_path / "run.rrd"
    with connect("sim", field=ROUGH, stereo=StereoConfig(4.0)) as link:
        with Recorder(path, link.robots, link.simulation) as recorder:
            run(link.robots, [Drive(recorder)], link.clock, [recorder], 6.0)
    assert path.stat().st_size <= 6.0e6
    assert len(columns(path)["/rover1/stereo/left"]["sim_time"]) >= 24


def red_pixels(picture):
    """Return rows and columns (2, N) of what is red in a picture."""
    blue, green, red = np.moveaxis(cv2.imread(str(picture)).astype(int), 2, 0)
    return np.array(np.nonzero((red > 60) & (red > 2 * green) & (red > 2 * blue)))


@pytest.mark.slow
@pytest.mark.skipif(
    ctypes.util.find_library("vulkan") is None, reason="no Vulkan; `make test` installs it by apt"
)
def test_screenshot_shows_the_scene_in_its_colours_and_the_rover_where_it_was(
    tmp_path, monkeypatch
):
    # The viewer's software Vulkan crashes with narrower vectors.
    monkeypatch.delenv("LP_NATIVE_VECTOR_WIDTH", raising=False)
    model = compile_scene()
    chassis = model.body("rover1/chassis").id
    model.geom_rgba[model.geom_bodyid == chassis] = [1.0, 0.0, 0.0, 1.0]
    simulation = Simulation(model, ["rover1"], suite=DATASHEET, servo=SERVO, seed=1)
    fast = Drive()
    fast.speed = 6.0
    with Recorder(tmp_path / "run.rrd", simulation.robots, simulation) as recorder:
        run(simulation.robots, [fast], simulation, [recorder], 2.0)
    middles = []
    for name, at in (("begin", 0.0), ("end", None)):
        screenshot(tmp_path / "run.rrd", tmp_path / f"{name}.png", at)
        rows, columns_ = red_pixels(tmp_path / f"{name}.png")
        assert len(rows) > 200
        middles.append([rows.mean(), columns_.mean()])
    # It drove half a metre, which is about its own length.
    assert np.linalg.norm(np.subtract(*middles)) > 20.0


def test_half_written_screenshot_is_waited_for(tmp_path):
    out = tmp_path / "view.png"
    whole = cv2.imencode(".png", np.zeros((4, 4), np.uint8))[1].tobytes()
    out.write_bytes(whole[:-5])
    with pytest.raises(RuntimeError, match="did not write"):
        _wait_for(out, time.monotonic())
    out.write_bytes(whole)
    _wait_for(out, time.monotonic())


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("/dev/full", "No space left on device"),
        ("/proc/run.rrd", "No such file"),
        ("/dev/null/run.rrd", "exists"),
    ],
)
def test_recording_that_cannot_be_written_is_named(path, reason):
    with pytest.raises(OSError, match=reason) as caught, Recorder(path) as recorder:
        recorder.log_text("notes", "lost")
    assert caught.value.filename in (path, "/dev/null")


@pytest.mark.parametrize("limit", [20_000, 2_000_000])
def test_disk_that_fills_up_ends_a_recording_with_its_name(tmp_path, limit):
    """It is full from the start, or fills up.

    The SDK alone waits for ever, always or now and then; a flush ends after half a minute.
    """
    path = tmp_path / "run.rrd"
    program = (
        "import os, resource, sys; from twin.recording.record import Recorder\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))\n"
        "try:\n"
        "    with Recorder(sys.argv[1]) as recorder:\n"
        "        for _ in range(100): recorder.log_text('notes', os.urandom(25_000).hex())\n"
        "except OSError as error: print(error.filename)"
    )
    words = [sys.executable, "-c", program, str(path)]
    done = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True, timeout=60)
    assert done.stdout == f"{path}\n"


def test_after_a_failed_write_nothing_waits_for_the_sdk(tmp_path, monkeypatch):
    """Neither is the stream let go of, nor the program's end left to the SDK."""
    left: list[object] = []
    monkeypatch.setattr(atexit, "unregister", left.append)

    def fails(**_):
        raise RuntimeError("the file is dead")

    recorder = Recorder(tmp_path / "run.rrd")
    stream = recorder._stream  # pyright: ignore
    monkeypatch.setattr(stream, "flush", fails)
    before = sys.getrefcount(stream)
    with pytest.raises(OSError, match="the file is dead"):
        recorder.close()
    assert left == [rr.rerun_shutdown] and sys.getrefcount(stream) == before + 1


def test_recording_larger_than_the_viewer_should_load_is_refused(tmp_path):
    path = tmp_path / "run.rrd"
    with path.open("wb") as stream:
        stream.truncate(2**32 + 1)  # Takes no place on the disk.
    with pytest.raises(OSError, match="4,294,967,297 bytes, the limit is 4,294,967,296"):
        screenshot(path, tmp_path / "out.png")


def test_screenshot_of_nothing_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no recording .*none\.rrd"):
        screenshot(tmp_path / "none.rrd", tmp_path / "out.png")
