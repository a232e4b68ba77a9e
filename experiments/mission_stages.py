"""The stages of ``mission``, each of which adds to what the robots know."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from controllers.identification.rover_identifier import RoverIdentifier, RoverIdentifierConfig
from controllers.insertion.card_arm import CardArm
from controllers.insertion.guidance import Guidance
from controllers.insertion.watcher import Watcher, WatcherConfig
from controllers.mapping.looking import MapperConfig, RobotBrief
from controllers.mapping.searching import TargetSearch, aim
from controllers.mapping.shared_map import SharedMap
from controllers.mapping.standing import Standing, lean
from controllers.mapping.stereo_mapper import StereoMapper
from controllers.mission.going import Going
from controllers.mission.looking import ArmMove
from controllers.motion.driving import Odometry
from experiments.ch2_rover_trial import known_swinging_arm
from experiments.insertion_identify import rover_steer
from experiments.insertion_setting import GuidanceRadio
from experiments.insertion_stand import Stand, card_cad, reference_arm, slot_cad, watch_plan
from experiments.mapping_scene import head_geometry
from experiments.mission_knowledge import SLOT_IN_SITE, Knowledge
from experiments.mission_scene import MASTER, SLAVE
from models.datasheets import ARM, CARD_AND_SLOT
from perception.registration_uncertainty import adjoint
from perception.target import possible_markers
from perception.voxel_grid import VoxelGrid
from perception.voxel_map import VoxelMap
from twin.robot import Command, Observation

FloatArray = NDArray[np.float64]
Observations = Mapping[str, Observation]

HOME = np.array(ARM.home)
VOXEL = 0.01  # [m]
BOX = ((-1.8, -2.4, -0.2), (1.8, 1.4, 0.68))
"""Corners of the map [m], about the panel."""
_LOOKS = 3  # Pairs in a row from which a robot that stands still is believed.
_TURN = 0.5  # Of the slave to and fro, had its wheels only rolled [rad].
_AROUND = ((0.0, -0.25), (0.0, 0.25), (0.25, 0.0), (-0.25, 0.0))
"""Turns of yaw and wrist from where the card should be, to look for it around there [rad]."""
_NEAR_STAND = (0.06, 0.12)  # From the stand [m] and its heading [rad] where it will do.
_MOST_GOES = 4  # Until it stands there, or stays where it is.
_GATE = 30.0  # Squared distance, whitened, beyond which it was not the card.
_STIRRED = np.diag(np.square([0.05, 0.05, _TURN, 0.05, 0.05, 0.02]))
"""Covariance of what a turn to and fro may change of the slot's pose in the robot's frame."""
_SPOT = 3.0  # Time for one of them, the way there included [s].


class Stage(Protocol):
    """One stage."""

    name: str

    @property
    def done(self) -> bool:
        """Whether the next one may begin."""
        ...

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Take what was measured and return the next commands."""
        ...


class SwingArms:
    """Chapter 2: each rover swings its arm and finds how it pitches on its springs."""

    name = "identify"

    def __init__(self, knowledge: Knowledge, rng: np.random.Generator) -> None:
        """Begin.

        Args:
            knowledge: Gets how both rovers pitch.
            rng: Of the planners.
        """
        self._knowledge = knowledge
        self._identifiers = {
            name: RoverIdentifier(
                RoverIdentifierConfig(name, known_swinging_arm(card=name == SLAVE)), source
            )
            for name, source in zip((MASTER, SLAVE), rng.spawn(2))
        }

    @property
    def done(self) -> bool:
        """Whether all arms have swung."""
        return len(self._knowledge.pitch) == len(self._identifiers)

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Swing on; the last step fits everything once more."""
        commands: dict[str, Command] = {}
        for name, identifier in self._identifiers.items():
            if identifier.done:
                self._knowledge.pitch[name] = identifier.finish()
            else:
                commands |= identifier.step(observations)
        return commands


class FindPanel:
    """Chapter 3: the master looks for the panel, and maps what it sees on the way."""

    name = "find"

    def __init__(self, knowledge: Knowledge, scans: int, rng: np.random.Generator) -> None:
        """Begin.

        Args:
            knowledge: Gets the map, and where the slot is from the master.
            scans: Looks.
            rng: Draws candidate views.
        """
        self._knowledge = knowledge
        self.mapper = StereoMapper(
            {MASTER: brief()},
            head_geometry(),
            knowledge.site.target,
            VoxelMap(VoxelGrid(VOXEL, *BOX)),
            MapperConfig(scans=scans),
            rng,
        )
        self._rest = ArmMove(HOME)

    @property
    def done(self) -> bool:
        """Whether no look is left."""
        return self.mapper.done

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Look on."""
        commands = dict(self.mapper.step(observations))
        commands[SLAVE] = self._rest.command(observations[SLAVE])
        found = self.mapper.standings.get(MASTER)
        if self.mapper.done and found is not None:
            self._knowledge.shared = self.mapper.shared
            take_standing(self._knowledge, found)
        return commands


class MapTogether:
    """Chapter 3: both rovers map the place, each leaving to the other what it is about to see."""

    name = "map"

    def __init__(self, knowledge: Knowledge, scans: int, rng: np.random.Generator) -> None:
        """Begin.

        Args:
            knowledge: Has the map that the master began, and where both stand.
            scans: Looks of each.
            rng: Draws candidate views.
        """
        assert knowledge.shared is not None and knowledge.standing is not None
        standings = {MASTER: knowledge.standing}
        if knowledge.met:
            standings[SLAVE] = _slave_standing(knowledge)
        self.mapper = StereoMapper(
            {name: brief() for name in standings},
            head_geometry(),
            knowledge.site.target,
            knowledge.shared.voxels,
            MapperConfig(scans=scans),
            rng,
            begun=knowledge.shared,
            standings=standings,
        )
        self._rest = ArmMove(HOME)

    @property
    def done(self) -> bool:
        """Whether no look is left."""
        return self.mapper.done

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Look on."""
        rest = {SLAVE: self._rest.command(observations[SLAVE])}
        return rest | dict(self.mapper.step(observations))


def _slave_standing(knowledge: Knowledge) -> Standing:
    """Return where the slave stands, by what the master has seen of its card."""
    assert knowledge.standing is not None
    arm, master = reference_arm(), knowledge.standing
    to_world = master.transform_level_to_world * knowledge.slot_in_level
    slot_in_slave = RigidTransform.from_matrix(knowledge.slot_in_slave)
    slave = to_world * slot_in_slave.inv()
    lift = adjoint(slave)
    spread = master.covariance + lift @ knowledge.slave_covariance @ lift.T
    tilt = knowledge.slave_tilt
    level = slave * lean(tilt).inv()
    sighting = slave * arm.camera_in_robot(HOME)
    return Standing(arm, level, spread, sighting, master.config)


def brief() -> RobotBrief:
    """Return what is known of the master beforehand."""
    return RobotBrief(reference_arm(), HOME, np.zeros((0, 4)))


def take_standing(knowledge: Knowledge, standing: Standing) -> None:
    """Work out where the slot is, from where the master stands.

    Args:
        knowledge: Has the drawing and the map's frame; gets the slot.
        standing: Of the master.
    """
    shared, site = knowledge.shared, knowledge.site
    assert shared is not None and shared.transform_target_to_world is not None
    to_world = shared.transform_target_to_world
    slot = to_world * site.transform_slot_to_panel
    drawn = adjoint(to_world)
    back = adjoint(standing.transform_level_to_world.inv())
    spread = standing.covariance + drawn @ site.covariance @ drawn.T
    knowledge.standing = standing
    knowledge.slot_in_level = standing.transform_level_to_world.inv() * slot
    knowledge.slot_covariance = back @ spread @ back.T


class Meet:
    """The master finds the card; the slave turns to and fro, and hears how far it truly turned.

    So both know where the other is, and the slave what skidding leaves of its turns, without a
    compass.
    """

    name = "meet"

    def __init__(
        self,
        knowledge: Knowledge,
        width: float,
        arm: CardArm,
        radio: GuidanceRadio,
        turns: bool,
        patience: float = 15.0,
    ) -> None:
        """Begin.

        Args:
            knowledge: Gets the share of a turn, and where the slot is from the slave.
            width: Of the slot [m].
            arm: Of the slave, with the card.
            radio: From the master to the slave.
            turns: Whether the slave turns; if not it is only looked for.
            patience: Time for each look-out, after which it is given up [s].
        """
        self.done = False
        self.met = False
        self._knowledge, self._width, self._arm, self._radio = knowledge, width, arm, radio
        self._watcher: Watcher | None = None
        self._master: ArmMove | None = None
        self._slave = ArmMove(HOME)
        self._patience, self._since = patience, math.nan
        self._around = iter(_AROUND)
        self._ahead, self._looked, self._centred = HOME, 0.0, False
        self._turns = [_TURN, -_TURN] if turns else []
        self._going: Going | None = None
        self._rolling = Odometry(rover_steer())
        self._heard: list[float] = []
        self._yaws: list[tuple[float, float]] = []

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Look, turn, and look again."""
        master, slave = observations[MASTER], observations[SLAVE]
        self._rolling.update(slave, 0.01)
        if self._watcher is None:
            self._look_out(master, slave)
        assert self._watcher is not None and self._master is not None
        watch = self._master.command(master)
        guidance = None
        if self._master.is_there(master):
            guidance = self._watcher.step(master)[1]
            if not self._centred and guidance is not None and guidance.card_seen:
                # It shall stay in view while the slave turns.
                self._aim_at(self._watcher.card, master)
                self._centred, guidance = True, None
            elif not self.met and master.time > self._looked + _SPOT:
                self._look_elsewhere(master)
        looks = self._radio.step(max(master.time, slave.time), guidance)
        return {MASTER: watch, SLAVE: self._answer(slave, looks)}

    def _look_out(self, master: Observation, slave: Observation) -> None:
        tilt = np.asarray(master.inclinometer.value, dtype=float)
        card_in_slave = self._arm.card_in_robot(HOME)
        slot, covariance = self._knowledge.slot_in_master(tilt)
        card = self._knowledge.card_in_master(tilt, card_in_slave)
        self._watcher = watcher(self._width, slot, covariance, card, plan=False)
        self._aim_at(card, master)

    def _aim_at(self, card: RigidTransform, master: Observation) -> None:
        """Bring the card into the middle of the view."""
        centre = card.apply([0.0, -CARD_AND_SLOT.card_length / 2.0, 0.0])
        self._ahead, self._looked = aim(reference_arm(), centre, HOME), master.time
        self._master = ArmMove(self._ahead)

    def _look_elsewhere(self, master: Observation) -> None:
        """Turn the camera to the next place where the card might be."""
        turns = next(self._around, None)
        if turns is None:
            return
        goal = self._ahead.copy()
        goal[[0, -1]] += turns
        self._master = ArmMove(np.clip(goal, *reference_arm().limits.T))
        self._looked = master.time

    def _answer(self, slave: Observation, looks: list[Guidance]) -> Command:
        if self._going is not None:
            command = self._going.step(slave)
            if not self._going.done:
                return command
            self._going, self._since, self._heard = None, slave.time, []
            self._slave = ArmMove(HOME)
        command = self._slave.command(slave)
        if math.isnan(self._since):
            if self._master is not None and self._slave.is_there(slave):
                self._since = slave.time
            return command
        if slave.inclinometer.usable:
            self._knowledge.slave_tilt = np.asarray(slave.inclinometer.value, dtype=float)
        for look in looks:
            if look.time >= self._since + 1.0 and look.transform_slot_to_card is not None:
                self._hear(look)
        if len(self._heard) >= _LOOKS:
            self._yaws.append((float(np.mean(self._heard)), self._rolling.yaw))
            self._go_on()
        elif slave.time > self._since + self._patience:
            self.done = True
        return command

    def _hear(self, look: Guidance) -> None:
        assert look.transform_slot_to_card is not None
        knowledge = self._knowledge
        card = RigidTransform.from_matrix(self._arm.card_in_robot(HOME))
        lift = adjoint(card)
        slot = card * look.transform_slot_to_card
        spread = lift @ look.covariance @ lift.T
        off = slot * RigidTransform.from_matrix(knowledge.slot_in_slave).inv()
        error = np.asarray(off.as_exp_coords())
        doubt = knowledge.slave_covariance + spread + _STIRRED
        if error @ np.linalg.solve(doubt, error) > _GATE:
            return  # Something else was taken for the card.
        self.met = knowledge.met = True
        forward = look.transform_slot_to_card.inv().rotation.as_matrix()[:, 1]
        self._heard.append(math.atan2(-forward[2], forward[1]))
        knowledge.slot_in_slave = slot.as_matrix()
        knowledge.slave_covariance = spread

    def _go_on(self) -> None:
        if self._turns:
            self._going = Going(rover_steer(), [0.0, 0.0, self._turns.pop(0)])
            return
        self.done = True
        if len(self._yaws) > 1:
            seen, rolled = np.abs(np.diff(np.array(self._yaws), axis=0)).sum(axis=0)
            self._knowledge.turn_share = float(seen / rolled)


class GoToStand:
    """Chapter 4: the master goes where it sees card and slot best, and finds the panel again.

    What it finds there tells how far dead reckoning has missed; if that is too far, it goes on.
    """

    name = "place"

    def __init__(self, knowledge: Knowledge, stand: Stand) -> None:
        """Begin.

        Args:
            knowledge: Gets where the slot is from the new place.
            stand: Where to go, on the level ground below the slot.
        """
        self.done = False
        self.found = False
        self._knowledge, self._stand, self._goes = knowledge, stand, 0
        self._rest = ArmMove(HOME)
        self._set_off()

    def _set_off(self) -> None:
        """Go to the stand from where the slot is seen now."""
        self._goes += 1
        self._going = Going(self._knowledge.steer(), self._way())
        self._fold = ArmMove(HOME)
        self._folded = False
        self._search: TargetSearch | None = None
        self._look: ArmMove | None = None

    def _way(self) -> FloatArray:
        """Return (3,) x to the right, y ahead [m] and turn [rad] to the stand from here."""
        site = self._knowledge.slot_in_level * SLOT_IN_SITE.inv()
        x, y, yaw = self._stand.place
        place = site.apply([x, y, 0.0])
        ahead = site.rotation.apply([-math.sin(yaw), math.cos(yaw), 0.0])
        return np.array([place[0], place[1], math.atan2(-ahead[0], ahead[1])])

    def _missed(self) -> bool:
        """Say whether it stands too far from where it shall."""
        x, y, turn = self._way()
        return math.hypot(x, y) > _NEAR_STAND[0] or abs(turn) > _NEAR_STAND[1]

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Fold the arm, drive, look for the panel."""
        seen = observations[MASTER]
        rest = self._rest.command(observations[SLAVE])
        if not self._folded:
            self._folded = self._fold.is_there(seen)
            return {MASTER: self._fold.command(seen), SLAVE: rest}
        if not self._going.done:
            return {MASTER: self._going.step(seen), SLAVE: rest}
        if self._look is None:
            self._reckon()
            if self._knowledge.shared is None:
                self.done = True
                return {MASTER: self._rest.command(seen), SLAVE: rest}
            self._begin_search()
        assert self._look is not None
        command = self._look.command(seen)
        if self._look.sees(seen):
            self._take(seen)
        return {MASTER: command, SLAVE: rest}

    def _reckon(self) -> None:
        """Bring the slot into the new frame by dead reckoning."""
        odometry, knowledge = self._going.odometry, self._knowledge
        x, y = odometry.place
        moved = RigidTransform.from_matrix(_planar_pose(x, y, odometry.yaw))
        knowledge.slot_in_level = moved.inv() * knowledge.slot_in_level
        turn = adjoint(moved.inv())
        way, turned = odometry.way, odometry.turned
        spread = np.diag(
            np.square(
                [0.02, 0.02, 0.03 + 0.05 * turned, 0.02 + 0.05 * way, 0.02 + 0.05 * way, 0.01]
            )
        )
        knowledge.slot_covariance = turn @ knowledge.slot_covariance @ turn.T + spread

    def _begin_search(self) -> None:
        """Look first where the panel should be."""
        knowledge, arm = self._knowledge, reference_arm()
        config = MapperConfig()
        survey = np.array(config.views.survey)
        extent = knowledge.site.target.extent
        self._search = TargetSearch(arm, HOME, survey, extent, config.search)
        panel = knowledge.slot_in_level * knowledge.site.transform_slot_to_panel.inv()
        self._look = ArmMove(aim(arm, panel.translation, survey))

    def _take(self, seen: Observation) -> None:
        shared, config, arm = self._knowledge.shared, MapperConfig(), reference_arm()
        assert isinstance(shared, SharedMap) and self._search is not None
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        tilt = np.asarray(seen.inclinometer.value, dtype=float)
        pair = np.asarray(seen.stereo.value, dtype=np.uint8)
        standing = shared.locate(arm, angles, tilt, pair, config.marker_sigma, config.standing)
        if standing is not None:
            take_standing(self._knowledge, standing)
            self.found = True
            if self._missed() and self._goes < _MOST_GOES:
                self._set_off()
            else:
                self.done = True
            return
        hints = possible_markers(pair, head_geometry(), self._knowledge.site.target)
        goal = self._search.after(angles, hints)
        if goal is None:
            self.done = True
        else:
            self._look = ArmMove(goal)


def _planar_pose(x: float, y: float, yaw: float) -> FloatArray:
    pose = np.eye(4)
    c, s = math.cos(yaw), math.sin(yaw)
    pose[:2] = [[c, -s, 0.0, x], [s, c, 0.0, y]]
    return pose


def watcher(
    width: float, slot: RigidTransform, covariance: FloatArray, card: RigidTransform, plan: bool
) -> Watcher:
    """Return the master's eyes for card and slot.

    Args:
        width: Of the slot [m].
        slot: From the slot to the robot.
        covariance: (6, 6) of its xi.
        card: From the card to the robot, roughly.
        plan: Whether the camera is placed, or stays.
    """
    config = WatcherConfig(
        card_cad(),
        slot_cad(width),
        CARD_AND_SLOT.marker_diameter,
        watch_plan() if plan else None,
    )
    return Watcher(config, reference_arm(), head_geometry(), (slot, covariance), card, None)
