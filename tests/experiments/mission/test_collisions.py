"""Collisions and falls: who touched what and when, against geometry and brute force."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.ch5.insertion_scene import MASTER, SLAVE, card_in_slot
from experiments.ch5.insertion_setting import InsertionTrial, prepare
from experiments.mission.collisions import CollisionMonitor, TipOverMonitor
from models.card_and_slot.guides import width_of
from models.clutter import PanelConfig, ScreenConfig, Solids
from models.compose import ROUGH, RobotPlacement, make_model, make_terrain, settle
from models.datasheets import ARM, CARD_AND_SLOT, CARD_GUIDE, ROVER
from tests.controllers.insertion.scenes import fresh
from tests.models.scenes import PLAIN
from twin.loop import Tick, run
from twin.robot import ArmMode, Command, WheelMode
from twin.simulation import Simulation

WHEEL = 2.0 * ROVER.wheel_radius
SPEED = 3.0
"""Speed of the wheels [rad/s]."""
NOSE, BUMPER = 0.15 + ROVER.wheel_radius, 0.22072
"""How far wheels and deck reach ahead of the rover's middle [m]."""


def forward(speed):
    """Command to drive straight on with the arm folded."""
    return Command(np.full(4, speed), np.array(ARM.home), WheelMode.SPEED, ArmMode.POSITION)


class Ahead:
    """Drives straight on, or back."""

    def __init__(self, robot="rover1", speed=SPEED):
        self.robot, self.speed = robot, speed

    def reset(self):
        pass

    def step(self, observations):
        return {self.robot: forward(self.speed)}


def scene(field, *robots):
    """Return a simulation at rest, and its ground."""
    model = make_model(field, robots)
    simulation = Simulation(model, [r.name for r in robots], data=settle(model, 0.5))
    return simulation, make_terrain(field, robots)


def with_screens(*screens):
    return dataclasses.replace(PLAIN, friction=0.8, screens=screens)


def drive(field, seconds, speed=SPEED):
    simulation, ground = scene(field, RobotPlacement())
    monitor = CollisionMonitor(simulation, ground)
    begin = simulation.data.body("rover1/chassis").xpos.copy()
    run(simulation.robots, [Ahead(speed=speed)], simulation, [monitor], seconds)
    return monitor.collisions, simulation.data.body("rover1/chassis").xpos - begin


def at(simulation, monitor, time):
    """Let a monitor see the present state at a time."""
    mujoco.mj_forward(simulation.model, simulation.data)
    monitor.record(Tick(0, time, {}, {}))


@pytest.mark.parametrize(
    "place, geom, reach",
    [((0.0, 0.6), "front_deck_collision", BUMPER), ((-0.14, 0.6), "front_left_tyre", NOSE)],
)
def test_rover_that_drives_into_a_block_touches_it_when_it_is_there(place, geom, reach):
    block = ScreenConfig(place, size=(WHEEL,) * 3)
    found, moved = drive(with_screens(block), 4.0)
    assert {(c.robot, c.touched) for c in found} == {("rover1", "screen0")}
    first = found[0]
    assert first.geom == f"rover1/{geom}"
    way = place[1] - WHEEL / 2.0 - reach
    # It takes a moment to reach its speed.
    assert first.begin == pytest.approx(way / (SPEED * ROVER.wheel_radius), abs=0.25)
    assert first.end == pytest.approx(4.0, abs=0.3)
    assert len(found) == len({c.geom for c in found})
    assert moved[1] < way + 0.1


@pytest.mark.parametrize("height, tyres", [(0.02, 0), (0.04, 2)])
def test_wheels_may_drive_over_what_is_20_mm_high_and_not_against_40_mm(height, tyres):
    sill = ScreenConfig((0.0, 0.45), size=(0.6, 0.08, height))
    found, moved = drive(with_screens(sill), 6.0)
    hit = {c.geom for c in found if c.geom.endswith("tyre")}
    assert len(hit) >= tyres and len(found) == len(hit)
    if tyres:
        assert {"rover1/front_left_tyre", "rover1/front_right_tyre"} <= hit
        assert {c.touched for c in found} == {"screen0"}
    else:
        assert moved[1] > 0.8  # All wheels have been over it.


@pytest.mark.parametrize("highest, count", [(0.0399, 2), (0.0401, 0)])
def test_height_that_counts_is_a_setting(highest, count):
    simulation, ground = scene(
        with_screens(ScreenConfig((0.0, 0.5), size=(0.6, 0.08, 0.04))), RobotPlacement()
    )
    monitor = CollisionMonitor(simulation, ground, highest)
    simulation.data.joint("rover1/root_joint").qpos[1] += 0.46 - NOSE + 0.012
    at(simulation, monitor, 0.0)
    assert len(monitor.collisions) == count


def test_contacts_less_than_a_second_apart_are_one_collision():
    simulation, ground = scene(
        with_screens(ScreenConfig((0.0, 0.6), size=(0.05, 0.1, 0.1))), RobotPlacement()
    )
    monitor = CollisionMonitor(simulation, ground)
    home = simulation.data.qpos.copy()
    place = simulation.data.joint("rover1/root_joint").qpos
    times = {0.0: True, 0.5: False, 0.99: True, 1.9: True, 3.0: False, 4.0: True, 4.5: True}
    for time, touching in times.items():
        simulation.data.qpos[:] = home
        place[1] += 0.55 - BUMPER + (0.002 if touching else -0.002)
        at(simulation, monitor, time)
    deck = "rover1/front_deck_collision"
    assert [(c.geom, c.touched, c.begin, c.end) for c in monitor.collisions] == [
        (deck, "screen0", 0.0, 1.9),
        (deck, "screen0", 4.0, 4.5),
    ]


def test_two_rovers_that_meet_have_both_collided():
    robots = RobotPlacement("rover1"), RobotPlacement("rover2", (0.0, 0.9), math.pi)
    simulation, ground = scene(PLAIN, *robots)
    monitor = CollisionMonitor(simulation, ground)
    drivers = [Ahead("rover1"), Ahead("rover2", 0.0)]
    run(simulation.robots, drivers, simulation, [monitor], 5.0)
    found = {(c.robot, c.geom, c.touched): c.begin for c in monitor.collisions}
    assert found
    for (robot, geom, touched), begin in found.items():
        other = touched.partition("/")[0]
        assert {robot, other} == {"rover1", "rover2"}
        assert found[other, touched, geom] == begin


def test_bodies_on_the_ground_and_at_the_panel_count_and_a_rover_s_own_do_not():
    panel = PanelConfig((1.0, 1.0))
    simulation, ground = scene(dataclasses.replace(PLAIN, panel=panel), RobotPlacement())
    monitor = CollisionMonitor(simulation, ground)
    data = simulation.data
    at(simulation, monitor, 0.0)
    assert monitor.collisions == ()
    # The hand down to the ground, and folded back onto the deck.
    for angles, touched in (((0.0, -0.7, -0.6, 0.0), {"ground"}), ((0.0, 2.0, 2.4, 0.0), set())):
        own = CollisionMonitor(simulation, ground)
        for name, angle in zip(("base_yaw", "shoulder", "elbow", "wrist"), angles):
            data.joint(f"rover1/{name}_joint").qpos = angle
        at(simulation, own, 0.0)
        assert {c.touched for c in own.collisions} == touched
    assert any(
        np.all(simulation.model.body_rootid[simulation.model.geom_bodyid[pair]] > 0)
        for pair in data.contact.geom
    )
    data.joint("rover1/root_joint").qpos[:2] = 1.0, 1.0 - NOSE
    at(simulation, monitor, 1.0)
    touched = {c.touched for c in monitor.collisions}
    assert touched and all(name.startswith("panel_") for name in touched)


@pytest.mark.parametrize("ahead, hits", [(-0.005, False), (0.02, True)])
def test_card_may_touch_the_slot_s_walls_and_the_hand_may_not(ahead, hits):
    model, data = fresh()
    simulation = Simulation(model, [MASTER, SLAVE], data=data)
    monitor = CollisionMonitor(simulation, make_terrain(PLAIN))
    root = data.joint(f"{SLAVE}/root_joint").qpos
    gap = 0.5 * (CARD_AND_SLOT.slot_widths[1] - CARD_AND_SLOT.card_width)
    # Before the slot or in it, lower by 2 mm than its play; across is down.
    mujoco.mj_forward(model, data)
    pose = card_in_slot(data)
    root[:3] += [-pose[2], ahead - pose[1], pose[0] - gap - 0.002]
    at(simulation, monitor, 0.0)
    names = {frozenset(model.geom(g).name for g in pair) for pair in data.contact.geom}
    card = {f"{SLAVE}/card_plate", "slot_left"}, {f"{SLAVE}/card_plate", "slot_right"}
    assert any(frozenset(pair) in names for pair in card) == hits
    assert monitor.collisions == ()
    # Through it, the hand comes to the walls.
    root[1] += 0.15
    at(simulation, monitor, 1.0)
    hit = {(c.geom, c.touched) for c in monitor.collisions}
    assert any(geom.startswith(f"{SLAVE}/") for geom, _ in hit)
    assert not any("card_" in geom and touched.startswith("slot_") for geom, touched in hit)


def test_a_card_may_touch_its_connector_and_what_holds_the_slot():
    setting = prepare(InsertionTrial(width_of(CARD_GUIDE.clearances[2]), True, 1, guides=True))
    simulation, ground = setting.simulation, make_terrain(setting.scene.field)
    model, data = simulation.model, simulation.data
    monitor = CollisionMonitor(simulation, ground)
    pose = card_in_slot(data)
    # Half a millimetre into the bottom.
    data.joint(f"{SLAVE}/root_joint").qpos[:3] += [-pose[2], 0.0405 - pose[1], pose[0]]
    at(simulation, monitor, 0.0)
    touched = {model.geom(geom).name for geom in data.contact.geom.flat}
    assert {"slot_spring_front", "slot_spring_back", "slot_bottom"} <= touched
    assert not any("card_" in collision.geom for collision in monitor.collisions)
    simulation.close()


def test_tyres_on_rocks_are_told_apart_as_the_terrain_has_them():
    """Brute force over all contacts, each with the terrain of its rock alone."""
    field = dataclasses.replace(ROUGH, rock_radius=(0.03, 0.05), texture_pixels=16, friction=0.9)
    simulation, ground = scene(field, RobotPlacement())
    rocks = [
        dataclasses.replace(ground, rocks=Solids(*(part[None] for part in rock)))
        for rock in zip(ground.rocks.centres, ground.rocks.half_sizes, ground.rocks.yaws)
    ]
    highest, begun, passed = 0.012, {}, set()
    monitor = CollisionMonitor(simulation, ground, highest)
    robot, model, data = simulation.robots["rover1"], simulation.model, simulation.data
    robot.activate()
    for _ in range(900):
        for contact in data.contact:
            tyre, rock = sorted((model.geom(int(g)).name for g in contact.geom), reverse=True)
            if tyre.endswith("_tyre") and rock.startswith("rock"):
                high = rocks[int(rock[4:])].rise_at(contact.pos[:2]) > highest
                if high:
                    begun.setdefault((tyre, rock), simulation.time)
                else:
                    passed.add((tyre, rock))
        monitor.record(Tick(0, simulation.time, {}, {}))
        robot.command(forward(4.0))
        simulation.tick()
    found = {}
    for collision in monitor.collisions:
        if collision.geom.endswith("_tyre"):
            found.setdefault((collision.geom, collision.touched), collision.begin)
    assert found == begun
    assert len(found) >= 3 and len(passed - found.keys()) >= 3


def test_tyres_on_the_ground_alone_are_looked_at_no_further():
    simulation, ground = scene(PLAIN, RobotPlacement())
    monitor = CollisionMonitor(simulation, ground)
    del monitor._owners, monitor._ground
    monitor.record(Tick(0, 0.0, {}, {}))
    assert simulation.data.ncon >= 4 and monitor.collisions == ()


@pytest.mark.parametrize("slope", [0.0, 0.3])
@pytest.mark.parametrize("pitch", [-1.06, -1.03, -0.8, 0.8, 1.03, 1.06])
def test_rover_has_fallen_from_sixty_degrees_by_the_plane_or_by_gravity(slope, pitch):
    field = dataclasses.replace(PLAIN, slope=(0.0, slope))
    simulation, _ = scene(field, RobotPlacement("rover1"), RobotPlacement("rover2", (1.5, 0.0)))
    monitor = TipOverMonitor(simulation)
    at(simulation, monitor, 0.0)
    assert monitor.fallen == {}
    quaternion = Rotation.from_euler("x", pitch).as_quat(scalar_first=True)
    simulation.data.joint("rover2/root_joint").qpos[3:] = quaternion
    for time in (1.0, 2.0):
        at(simulation, monitor, time)
    # Gravity's opposite is tilted ahead by the slope: what pitches up is nearer to falling by it.
    steepest = max(abs(pitch), abs(pitch + slope))
    assert monitor.fallen == ({"rover2": 1.0} if steepest > math.radians(60.0) else {})
