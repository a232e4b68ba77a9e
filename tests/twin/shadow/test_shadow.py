"""A shadow beside simulated rovers, whose truth is known here."""

import dataclasses

import mujoco
import numpy as np
import pytest

from models.compose import FieldConfig, RobotPlacement
from twin.connect import connect
from twin.describe import describe_rover
from twin.loop import LoopRecorder, run
from twin.robot import MISSING, ArmMode, Command, WheelMode
from twin.shadow.deviations import hasten, rover_deviations, shadow_scene
from twin.shadow.gain import ShadowNoise, SteadyGain
from twin.shadow.readings import CHANNELS, Readings
from twin.shadow.shadow import Shadow, ShadowConfig

ROBOT = "rover1"
DRAWN = describe_rover(ROBOT)
AROUND = np.array([0.6, 0.2, 0.25, 0.3])
LEVEL = FieldConfig(size=(6.0, 6.0), texture_pixels=16)


class Working:
    """Drives and turns while the arm swings about its rest posture."""

    def __init__(self, turning=0.8):
        self._turning = turning

    def reset(self):
        pass

    def step(self, observations):
        time = observations[ROBOT].time
        drive, turn = 1.5 * np.sin(0.9 * time), self._turning * np.sin(0.5 * time + 1.0)
        phases = np.array([1.1, 1.7, 1.4, 2.1]) * time
        ramp = min(time, 1.0)
        wheels = ramp * (drive + turn * np.array([-1.0, 1.0, -1.0, 1.0]))
        arm = DRAWN.arm.home + ramp * AROUND * np.sin(phases)
        return {ROBOT: Command(wheels, arm, WheelMode.SPEED, ArmMode.POSITION)}


class Beside(LoopRecorder):
    """Steps a shadow with what a controller sees, and keeps its innovations.

    After a tick of a given number it tries out given deviations.
    """

    def __init__(self, shadow, seen=lambda each: each, tries=(-1, ())):
        self._shadow, self._seen, self._applied = shadow, seen, Command(np.zeros(4), np.zeros(4))
        self._tries = tries
        self.found = []

    def record(self, tick):
        innovation = self._shadow.step(self._seen(tick.observations[ROBOT]), self._applied)
        self._applied = tick.applied[ROBOT]
        if innovation is not None:
            self.found.append(innovation)
        when, rows = self._tries
        if tick.step == when:
            self._shadow.try_out(np.array(rows))


def beside(
    seconds,
    deviations=(),
    change=None,
    known=0.0,
    seen=lambda each: each,
    slope=(0.0, 0.0),
    motion=None,
    even=True,
    tries=(-1, ()),
):
    field = FieldConfig(size=(6.0, 6.0), texture_pixels=16, slope=slope)
    config = ShadowConfig(even=even)
    shadow = Shadow(shadow_scene(RobotPlacement(ROBOT)), DRAWN, deviations, config)
    shadow.know(np.full(len(deviations), known))
    beside = Beside(shadow, seen, tries)
    with connect("sim", field=field, realism="ideal", seed=4) as connection:
        if change is not None:
            change(connection.simulation.model)
        run(connection.robots, [motion or Working()], connection.clock, [beside], seconds)
    shadow.close()
    return shadow, beside.found


def quarters(found, what):
    """Means of a quarter of a second, in deviations; wheels that slide anew each time cancel."""
    rows = np.array([getattr(each, what) / each.sigma for each in found[100:]])
    count = len(rows) // 25
    parts = rows[: 25 * count].reshape(count, 25, -1)
    there = np.isfinite(parts)
    return np.where(there, parts, 0.0).sum(axis=1) / np.maximum(there.sum(axis=1), 1)


@pytest.fixture(scope="module")
def drawn():
    """Beside the robot as drawn."""
    return beside(12.0)


def test_of_a_robot_as_drawn_it_misses_little_but_the_noise(drawn):
    shadow, found = drawn
    values = np.array([each.values for each in found])[200:]
    for name, sigma in (("arm_rates", 0.01), ("wheel_speeds", 0.02), ("arm_base_wrench", 0.1)):
        place = shadow.channels[name]
        noise = np.broadcast_to(DRAWN.sensor_sigma[name], place.stop - place.start)
        assert noise[0] == pytest.approx(sigma)
        off = np.sqrt(np.mean(values[:, place] ** 2, axis=0)) / noise
        # The twin corrects itself by noise, too; its steps are twice as long.
        assert np.all(off > 0.9) and np.all(off < 4.0), name  # noqa: PLR2004


def test_it_states_more_than_it_misses_of_a_robot_as_drawn(drawn):
    _, found = drawn
    squares = np.nanmean([np.square(each.values / each.sigma) for each in found[200:]], axis=0)
    assert np.all(squares < 1.0)


def test_innovations_of_a_robot_as_drawn_are_nearly_white(drawn):
    shadow, found = drawn
    values = np.array([each.values for each in found])[200:]
    for name in ("arm_rates", "wheel_speeds", "arm_base_wrench"):
        for column in values[:, shadow.channels[name]].T:
            assert abs(np.corrcoef(column[:-1], column[1:])[0, 1]) < 0.5  # noqa: PLR2004


def add_load(model):
    """Put 0.1 kg where the gripper holds things."""
    body, site = model.body(f"{ROBOT}/wrist"), model.site(f"{ROBOT}/gripper")
    mass, centre = float(body.mass[0]), body.ipos.copy()
    moved = (mass * centre + 0.1 * site.pos) / (mass + 0.1)
    # The inertia of two points about their common centre, added to that of the wrist.
    apart = float(np.sum((site.pos - centre) ** 2)) * mass * 0.1 / (mass + 0.1)
    body.inertia[:] += apart
    body.mass[0], body.ipos[:] = mass + 0.1, moved
    mujoco.mj_setConst(model, mujoco.MjData(model))


def work_loaded(kept):
    """Let a rover with that load work for five seconds."""
    field = FieldConfig(size=(6.0, 6.0), texture_pixels=16)
    with connect("sim", field=field, realism="ideal", seed=4) as connection:
        add_load(connection.simulation.model)
        run(connection.robots, [Working()], connection.clock, [kept], 5.0)


def soften(model):
    model.joint(f"{ROBOT}/front_left_suspension_joint").stiffness[0] *= 0.6


def brake(model):
    model.dof_frictionloss[model.joint(f"{ROBOT}/rear_right_joint").dofadr[0]] += 0.3


class Swinging(Working):
    """Swings its arm where it stands: how the ground tilts below a rover that drives, it tells."""

    def step(self, observations):
        arm = super().step(observations)[ROBOT].arm
        return {ROBOT: Command(np.zeros(4), arm, WheelMode.SPEED, ArmMode.POSITION)}


@pytest.mark.parametrize(
    ("name", "change", "size", "near", "motion"),
    [
        ("load gripper", add_load, 0.1, 0.01, Working()),
        ("spring front_left", soften, -0.4, 0.15, Swinging()),
        ("drag rear_right", brake, 0.3, 0.1, Working()),
    ],
)
def test_its_sensitivities_tell_what_the_robot_deviates_by(name, change, size, near, motion):
    chosen = [each for each in rover_deviations(DRAWN) if each.name == name]
    _, found = beside(15.0, chosen, change, motion=motion)
    values, slopes = quarters(found, "values").ravel(), quarters(found, "sensitivities").ravel()
    assert slopes @ values / (slopes @ slopes) == pytest.approx(size, abs=near)


def test_a_copy_whose_encoder_sticks_explains_one_that_sticks():
    """The elbow's, after six seconds; before, it reads other angles."""
    stuck = []

    def sticking(seen):
        if seen.time < 6.0:  # noqa: PLR2004
            return seen
        stuck[:] = stuck or [seen.arm_angles.value[2]]
        angles, rates = seen.arm_angles.value.copy(), seen.arm_rates.value.copy()
        angles[2], rates[2] = stuck[0], 0.0
        return seen._replace(
            arm_angles=seen.arm_angles._replace(value=angles),
            arm_rates=seen.arm_rates._replace(value=rates),
        )

    names = ("stuck elbow", "blocked elbow")
    chosen = [each for each in rover_deviations(DRAWN) if each.name in names]
    assert [each.name for each in chosen] == list(names)
    _, found = beside(8.0, chosen, seen=sticking, tries=(10, np.eye(2)))
    before, later = (
        np.nanmean(
            [np.square(np.vstack([each.values, each.tried]) / each.sigma) for each in part],
            axis=(0, 2),
        )
        for part in (found[100:580], found[600:720])
    )
    assert min(before[1:]) > 10.0 * before[0]
    without, stuck_one, blocked = later
    assert without > 10.0 * before[0]
    assert stuck_one == pytest.approx(before[0], rel=0.5)
    # The arm goes on: what it is felt to do is not that of a joint that is blocked.
    assert blocked > 1.5 * stuck_one


def test_a_tilt_that_drives_along_is_told_from_that_of_the_ground():
    """The roll's zero drifts after ten seconds, while the rover turns."""

    def drifting(seen):
        drift = [0.0, 0.03 * (seen.time >= 10.0)]  # noqa: PLR2004
        tilt = seen.inclinometer
        return seen._replace(inclinometer=tilt._replace(value=np.asarray(tilt.value) + drift))

    chosen = [each for each in rover_deviations(DRAWN) if each.name == "zero roll"]
    _, found = beside(15.0, chosen, seen=drifting, motion=Turning())
    before, later = (
        np.array([each.values[-2:] for each in part]).mean(axis=0)
        for part in (found[500:1000], found[1100:])
    )
    assert before == pytest.approx(0.0, abs=0.015)
    effect = np.array([each.sensitivities[0, -2:] for each in found[500:]]).mean(axis=0)
    assert later == pytest.approx(0.03 * effect, abs=0.01)
    assert effect == pytest.approx([0.0, -1.0], abs=0.35)


def test_on_uneven_ground_neither_a_tilt_that_drives_along_nor_a_twist_tells_anything():
    shadow, found = beside(1.0, (), even=False)
    values = np.array([each.values for each in found])
    silent = [shadow.channels["centre_angle"].start, -2, -1]
    assert np.isnan(values[:, silent]).all()
    assert np.isfinite(np.delete(values, silent, axis=1)).any(axis=0).all()


def test_a_wheel_that_is_measured_to_turn_neither_sticks_nor_is_blocked():
    wheels = [f"{kind} {wheel}" for wheel in DRAWN.wheel_names for kind in ("stuck", "blocked")]
    chosen = [each for each in rover_deviations(DRAWN) if each.name in wheels]
    _, found = beside(10.0, chosen, motion=Turning())
    refuted = np.array([each.refuted for each in found])
    assert refuted.shape[1] == 8  # noqa: PLR2004
    # It begins at rest.
    assert not refuted[0].any()
    assert refuted[200:].mean() > 0.8  # noqa: PLR2004


def test_what_is_tried_out_is_what_the_twin_would_miss_if_it_knew_it():
    """From the same state on, beside a rover that has the load."""
    deviations = [each for each in rover_deviations(DRAWN) if each.name == "load gripper"]
    misses = {}
    for known in (0.0, 0.1):
        shadow = Shadow(shadow_scene(RobotPlacement(ROBOT)), DRAWN, deviations)
        shadow.know(np.array([known]))
        kept = Beside(shadow, tries=(300, [[0.05], [0.1]]))
        work_loaded(kept)
        shadow.close()
        late = kept.found[400:]
        misses[known] = np.nanmean([(each.values / each.sigma) ** 2 for each in late])
        tried = np.nanmean([(each.tried / each.sigma) ** 2 for each in late], axis=(0, 2))
        assert len(kept.found[250].tried) == 0
    # The second twin knows all of it, and tries out half of it and the same.
    assert tried[1] == pytest.approx(misses[0.1], rel=0.1)
    assert misses[0.1] < 0.5 * tried[0] < 0.3 * misses[0.0]


def test_a_copy_that_is_turned_with_its_ground_expects_the_same():
    """No reading tells which way a rover heads."""
    shadow = Shadow(shadow_scene(RobotPlacement(ROBOT)), DRAWN, ())
    field = FieldConfig(size=(6.0, 6.0), texture_pixels=16, slope=(0.1, -0.06))
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])

    class Trying(Beside):
        def record(self, tick):
            super().record(tick)
            if tick.step == 400:  # noqa: PLR2004
                shadow.try_out(np.empty((1, 0)))
                state, rates = shadow._states[1], 1 + shadow.model.nq
                w, x, y, z = state[4:8]
                state[4:8] = np.array([w - z, x - y, y + x, z + w]) / np.sqrt(2.0)
                state[rates : rates + 2] = turn @ state[rates : rates + 2]
                pitch, roll = shadow._grounds[0, :2]
                right, forward = turn @ [roll, -pitch]
                shadow._grounds[1, :2] = -forward, right
                shadow._tilt_gravity()

    kept = Trying(shadow)
    with connect("sim", field=field, realism="ideal", seed=4) as connection:
        run(connection.robots, [Working()], connection.clock, [kept], 5.0)
    shadow.close()
    later = kept.found[402:]
    apart = [(each.tried[0] - each.values)[:-2] / each.sigma[:-2] for each in later]
    assert np.nanmax(np.abs(apart)) < 1e-6  # noqa: PLR2004


def test_what_it_knows_it_expects():
    deviations = [each for each in rover_deviations(DRAWN) if each.name == "load gripper"]
    elbow = []
    for known in (0.0, 0.1):
        shadow, found = beside(5.0, deviations, add_load, known=known)
        values = quarters(found, "values")[:, shadow.channels["arm_rates"]]
        elbow.append(np.sqrt(np.mean(values[:, 2] ** 2)))
    assert elbow[0] > 10.0 * elbow[1]


def test_it_foresees_by_what_is_applied_and_by_what_it_is_told():
    """A load in the gripper, told and not told, beside a rover that has it: a second ahead."""
    deviations = [each for each in rover_deviations(DRAWN) if each.name == "load gripper"]
    errors = []
    for told in (0.0, 0.1):
        shadow = Shadow(shadow_scene(RobotPlacement(ROBOT)), DRAWN, deviations)

        class Foreseeing(Beside):
            def record(self, tick, told=told):
                super().record(tick)
                if tick.step in (300, 400):
                    self._shadow.foresee(np.array([told]))

        kept = Foreseeing(shadow)
        work_loaded(kept)
        shadow.close()
        angles = shadow.channels["arm_angles"]
        errors.append([np.abs(each.foreseen[angles]).max() for each in kept.found])
    # Begun anew, it is off by no more than the twin, and later by what it was not told.
    for row in errors:
        assert row[301] < 2e-3 and row[401] < 2e-3  # noqa: PLR2004
    assert max(errors[1][302:401]) < 0.2 * max(errors[0][302:401])


def followed(gain, angles):
    for _ in range(100):
        gain.follow(angles)


def test_a_posture_where_a_touch_makes_all_the_difference_leaves_the_gain_as_it_was(monkeypatch):
    model = shadow_scene(RobotPlacement(ROBOT))
    readings = Readings(model, DRAWN)
    home, out = np.asarray(DRAWN.arm.home), np.asarray(DRAWN.arm.home) + [0.3, 0.1, 0.1, 0.0]
    linearised, wild = SteadyGain._linearised, [False]

    def touching(self):
        transition, sensed = linearised(self)
        return transition * (1e17 if wild[0] else 1.0), sensed

    monkeypatch.setattr(SteadyGain, "_linearised", touching)
    gain, other = (SteadyGain(model, readings, ShadowNoise(), 5) for _ in range(2))
    gain.follow(home)
    before = gain.gain.copy()
    wild[0] = True
    followed(gain, out)
    np.testing.assert_array_equal(gain.gain, before)
    wild[0] = False
    followed(gain, home + [-0.3, 0.1, 0.1, 0.0])
    assert np.abs(gain.gain - before).max() > 1e-4  # noqa: PLR2004
    # One that begins there has the gain of the rest posture.
    calls = []

    def touching_at_first(self):
        calls.append(0)
        transition, sensed = linearised(self)
        return transition * (1e17 if len(calls) == 1 else 1.0), sensed

    monkeypatch.setattr(SteadyGain, "_linearised", touching_at_first)
    other.follow(out)
    np.testing.assert_allclose(other.gain, before, atol=1e-9)


def test_it_learns_the_slope_that_it_stands_on():
    shadow, _ = beside(6.0, slope=(0.06, -0.04), motion=Working(turning=0.0))
    # `FieldConfig.slope` is that along x and y; pitch is about x, and lifts y.
    assert shadow.slope == pytest.approx([-0.04, -0.06], abs=0.006)


class Turning:
    """Turns to the left where it stands, and sways ahead and back as it does."""

    def reset(self):
        pass

    def step(self, observations):
        time = observations[ROBOT].time
        wheels = min(time, 1.0) * (2.5 * np.array([-1.0, 1.0, -1.0, 1.0]) + np.sin(2.0 * time))
        return {ROBOT: Command(wheels, DRAWN.arm.home, WheelMode.SPEED, ArmMode.POSITION)}


def test_slope_stays_that_of_the_ground_as_the_rover_turns():
    field = FieldConfig(size=(6.0, 6.0), texture_pixels=16, slope=(0.06, -0.04))
    shadow = Shadow(shadow_scene(RobotPlacement(ROBOT)), DRAWN, ())
    kept, headings = Beside(shadow), []
    with connect("sim", field=field, realism="ideal", seed=4) as connection:
        data = connection.simulation.data

        def around():
            rotation = data.body(f"{ROBOT}/chassis").xmat.reshape(3, 3)
            headings.append(np.arctan2(rotation[1, 0], rotation[0, 0]))
            return False

        run(connection.robots, [Turning()], connection.clock, [kept], 30.0, around)
    turned = np.unwrap(headings)
    assert turned[-1] - turned[0] > np.pi
    # The ground rises along x: what is ahead for one heading is to the side for another.
    cosine, sine = np.cos(turned[-1]), np.sin(turned[-1])
    right, ahead = cosine * 0.06 - sine * 0.04, -sine * 0.06 - cosine * 0.04
    assert shadow.slope == pytest.approx([ahead, -right], abs=0.025)
    late = np.nanmean([np.square(each.values / each.sigma) for each in kept.found[1500:]], axis=0)
    assert np.all(late < 6.0)  # noqa: PLR2004
    shadow.close()


def test_channels_that_are_missing_leave_it_to_predict():
    def without(observation):
        lost = observation.time > 3.0  # noqa: PLR2004
        return observation._replace(gyro=MISSING, arm_base_wrench=MISSING) if lost else observation

    shadow, found = beside(5.0, seen=without)
    last = found[-1]
    for name in ("gyro", "arm_base_wrench"):
        assert np.isnan(last.values[shadow.channels[name]]).all()
    assert np.isfinite(last.sensitivities).all()
    rates = [each.values[shadow.channels["arm_rates"]] for each in found[400:]]
    assert np.sqrt(np.mean(np.square(rates))) < 0.02  # noqa: PLR2004


class Lossy(Beside):
    """Leaves out two ticks of twenty, and once a second."""

    def record(self, tick):
        if tick.step % 20 > 1 and not 600 <= tick.step < 700:
            super().record(tick)


def test_what_is_lost_is_predicted_and_after_a_longer_gap_it_begins_anew(drawn):
    field = LEVEL
    with connect("sim", field=field, realism="ideal", seed=4) as connection:
        shadow = Shadow(shadow_scene(RobotPlacement(ROBOT)), DRAWN, ())
        lossy = Lossy(shadow)
        run(connection.robots, [Working()], connection.clock, [lossy], 9.0)
        shadow.close()
    times = np.array([each.time for each in lossy.found])
    # One observation of each beginning is lost, and none for what was left out before.
    assert len(times) == np.count_nonzero(np.arange(900) % 20 > 1) - 90 - 2
    for found in (lossy.found[200:500], lossy.found[600:]):
        squares = np.nanmean([np.square(each.values / each.sigma) for each in found], axis=0)
        assert np.all(squares < 2.0)  # noqa: PLR2004


def test_a_twin_that_is_lost_begins_anew_where_the_robot_is():
    """Someone turns it over to one side, by more than a twin can follow."""
    shadow = Shadow(shadow_scene(RobotPlacement(ROBOT)), DRAWN, ())
    kept, tilted = Beside(shadow), np.array([0.0, 0.9])

    def turned(seen):
        if seen.time < 2.0:  # noqa: PLR2004
            return seen
        force = np.array([-9.81 * np.sin(0.9), 0.0, 9.81 * np.cos(0.9)])
        return seen._replace(
            inclinometer=seen.inclinometer._replace(value=tilted),
            accelerometer=seen.accelerometer._replace(value=force),
            gyro=seen.gyro._replace(value=np.array([0.0, 8.0, 0.0]) * (seen.time < 8.0)),  # noqa: PLR2004
            arm_base_wrench=seen.arm_base_wrench._replace(value=np.full(6, 60.0)),
        )

    kept._seen = turned
    with connect("sim", realism="ideal", seed=4) as connection:
        run(connection.robots, [Working()], connection.clock, [kept], 9.0)
    shadow.close()
    gaps = np.diff([each.time for each in kept.found])
    (begun,) = np.flatnonzero(gaps > 0.015)[:1]  # noqa: PLR2004
    assert 4.5 < kept.found[begun].time < 8.0  # noqa: PLR2004


def test_it_waits_for_what_it_begins_with():
    def late(observation):
        early = observation.time < 1.0
        return observation._replace(arm_angles=MISSING) if early else observation

    _, found = beside(1.5, seen=late)
    assert 1.0 < found[0].time < 1.05 and len(found) < 52  # noqa: PLR2004


def test_every_deviation_changes_what_is_expected():
    """None of them is a name alone: of what happens wholly or not, a copy that has it differs."""
    deviations = rover_deviations(DRAWN)
    assert len({each.name for each in deviations}) == len(deviations)
    whole = np.flatnonzero([bool(each.encoder) for each in deviations])
    rows = np.eye(len(deviations))[whole]
    _, found = beside(3.0, deviations, tries=(20, rows))
    reach = np.max([np.abs(each.sensitivities / each.sigma) for each in found[50:]], axis=(0, 2))
    assert not reach[whole].any()
    apart = [np.abs(each.tried - each.values) / each.sigma for each in found[50:]]
    reach[whole] = np.nanmax(apart, axis=(0, 2))
    for deviation, largest in zip(deviations, reach, strict=True):
        assert largest * abs(deviation.step) > 0.01, deviation.name  # noqa: PLR2004
    assert set(dataclasses.asdict(deviations[0])) >= {"spread", "change", "step"}
    assert len(CHANNELS) == 8  # noqa: PLR2004


def test_a_hastened_model_does_what_a_converging_solver_does():
    exact = shadow_scene(RobotPlacement(ROBOT))
    hasty = shadow_scene(RobotPlacement(ROBOT))
    hasten(hasty)
    one, other = mujoco.MjData(exact), mujoco.MjData(hasty)
    mujoco.mj_resetDataKeyframe(exact, one, 0)
    rng, errors, moved = np.random.default_rng(1), [], []
    axes = [exact.actuator(f"{ROBOT}/{name}").id for name in DRAWN.axes]
    for _ in range(200):
        one.ctrl[axes] = exact.actuator_ctrlrange[axes, 1] * rng.uniform(-0.6, 0.6, len(axes))
        for data in (one, other):
            data.qpos[:], data.qvel[:], data.ctrl[:] = one.qpos, one.qvel, one.ctrl
            data.qacc_warmstart[:] = 0.0
        before = one.qvel.copy()
        mujoco.mj_step(exact, one, 5)
        mujoco.mj_step(hasty, other, 5)
        errors.append(np.abs(other.qvel - one.qvel).max())
        moved.append(np.abs(one.qvel - before).max())
    assert np.median(errors) < 0.02
    assert np.median(errors) < 0.01 * np.median(moved)


def test_ground_that_twists_below_a_rover_that_drives_is_none_of_its_springs():
    """The centre joint follows the ground, by ten of its deviations and more; the twin's stays."""
    field = FieldConfig(size=(6.0, 6.0), relief=0.02, texture_pixels=16, seed=4)
    config = ShadowConfig(even=False)
    shadow = Shadow(shadow_scene(RobotPlacement(ROBOT)), DRAWN, (), config)
    kept, angles, own = Beside(shadow), [], []
    joint = shadow.model.joint(f"{ROBOT}/centre_joint").qposadr[0]

    def follows():
        angles.append(float(connection.simulation.data.joint(f"{ROBOT}/centre_joint").qpos[0]))
        own.append(0.0 if shadow.places is None else float(shadow.places[joint]))
        return False

    with connect("sim", field=field, realism="ideal", seed=4) as connection:
        run(connection.robots, [Working()], connection.clock, [kept], 15.0, follows)
    shadow.close()
    sigma = kept.found[-1].sigma[shadow.channels["centre_angle"]][0]
    assert np.ptp(angles) > 20 * sigma
    assert np.std(own) < 0.5 * np.std(angles)


def test_what_twists_a_rover_on_even_ground_is_its_own():
    """A spring goes soft: how far the centre turns by that, MuJoCo tells of the rover at rest."""
    model = shadow_scene(RobotPlacement(ROBOT))
    joint = model.joint(f"{ROBOT}/centre_joint").qposadr[0]
    soften(model)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(3000):
        mujoco.mj_step(model, data)
    turned = float(data.qpos[joint])
    for even in (True, False):
        shadow, _ = beside(12.0, change=soften, motion=Swinging(), even=even)
        twist, own = shadow._grounds[0, 2], shadow.places[joint]
        assert twist == pytest.approx(0.0 if even else turned, abs=0.05 * turned)
        # A filter lies between what its springs expect and what is measured.
        assert bool(0.3 * turned < own < turned) is even, own


def test_what_is_tried_out_begins_on_the_ground_as_it_was():
    """A wheel turns hard, which the twin takes for steeper ground; its copies need not."""
    deviations = [each for each in rover_deviations(DRAWN) if each.name == "drag rear_right"]
    shadow = Shadow(shadow_scene(RobotPlacement(ROBOT)), DRAWN, deviations)
    field, slopes = LEVEL, []

    class Trying(Beside):
        def record(self, tick):
            if tick.step == 800:  # noqa: PLR2004
                model = connection.simulation.model
                model.dof_frictionloss[model.joint(f"{ROBOT}/rear_right_joint").dofadr[0]] += 3.0
            super().record(tick)
            if tick.step == 1000:  # noqa: PLR2004
                slopes.append(np.abs(shadow.slope).max())
                self._shadow.try_out(np.array([[3.0]]))

    kept = Trying(shadow)
    with connect("sim", field=field, realism="ideal", seed=4) as connection:
        run(connection.robots, [Working()], connection.clock, [kept], 11.0)
    shadow.close()
    assert slopes[0] > 0.05  # noqa: PLR2004
    later = kept.found[1000:1075]
    tried = np.nanmean([(each.tried[0] / each.sigma) ** 2 for each in later])
    unchanged = np.nanmean([(each.values / each.sigma) ** 2 for each in later])
    assert tried < 0.05 * unchanged


def test_what_is_tried_out_goes_on_while_the_twin_foresees():
    """A spring goes soft; what a copy with a soft one expects is the same with and without."""
    deviations = [each for each in rover_deviations(DRAWN) if each.name == "spring front_right"]
    found = []
    for foresees in (False, True):
        shadow = Shadow(shadow_scene(RobotPlacement(ROBOT)), DRAWN, deviations)

        class Trying(Beside):
            def record(self, tick, shadow=shadow, foresees=foresees):
                super().record(tick)
                if foresees and tick.step in (150, 170):
                    shadow.foresee(np.zeros(1))

        kept = Trying(shadow, tries=(100, [[-0.5]]))
        with connect("sim", field=LEVEL, realism="ideal", seed=4) as connection:
            run(connection.robots, [Working()], connection.clock, [kept], 2.0)
        shadow.close()
        found.append([each.tried for each in kept.found[101:]])
    np.testing.assert_array_equal(*found)
