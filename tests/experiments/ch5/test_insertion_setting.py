"""Trials begin as stated: what the robots know, of which robots, and what is scored when."""

import contextlib
import dataclasses

import mujoco
import numpy as np
import pytest
from scipy.stats import chi2

from controllers.insertion.guidance import Guidance
from experiments.ch5.insertion_scene import MASTER, SLAVE, transform_between
from experiments.ch5.insertion_setting import InsertionTrial, prepare
from experiments.ch5.insertion_trial import Scorer
from models.datasheets import CARD_AND_SLOT
from tests.twin.test_truth_barrier import leaks
from twin.loop import Tick
from twin.realism import REALISMS

WIDTH = CARD_AND_SLOT.slot_widths[1]


@contextlib.contextmanager
def prepared(seed, **changes):
    setting = prepare(InsertionTrial(WIDTH, True, seed, **changes))
    with contextlib.closing(setting.simulation):
        yield setting


def surprise(true, believed, covariance):
    """Return the squared Mahalanobis distance of a true pose from a believed one."""
    xi = np.asarray((true * believed.inv()).as_exp_coords())
    return float(xi @ np.linalg.solve(covariance, xi))


@pytest.mark.parametrize("realism", ["ideal", "default"])
def test_map_is_of_the_place_where_the_robots_begin(realism):
    """On this ground the master slides by 37 mm when its arm leaves the posture of rest."""
    with prepared(302038678, realism=realism) as setting:
        data, team = setting.simulation.data, setting.team
        guide, belief = team.master.marker_guide, team.slave.inserter.belief
        true = transform_between(data, "slot", f"{MASTER}/chassis")
        gate = chi2.ppf(0.999, 6)
        assert surprise(true, guide.transform_slot_to_robot, guide.slot_covariance) < gate
        true = transform_between(data, "slot", f"{SLAVE}/chassis")
        believed = type(true).from_matrix(belief.slot_in_start)
        assert surprise(true, believed, belief.covariance) < gate


def test_robots_as_made_are_described_by_what_is_stated_of_all_such_robots():
    described = []
    for seed in (3, 4):
        with prepared(seed, realism="default") as setting:
            assert leaks(setting.team) == []
            left, right = setting.simulation.heads[MASTER].poses(setting.simulation.data)
            # They differ as made ...
            rows = (left.inv() * right).as_exp_coords()
            head = setting.simulation.robots[MASTER].description.head
            assert head is not None
            described.append((head.calibration, head.exposure, rows))
    (one, exposure, made), (two, _, other) = described
    assert not np.allclose(made, other)
    # ... and are described alike.
    assert one == two == REALISMS["default"].cameras.calibration
    assert exposure == REALISMS["default"].cameras.exposure > 0.0


def test_guidance_is_scored_by_where_the_card_was_when_its_images_were_taken():
    with prepared(5) as setting:
        scorer, data = Scorer(setting), setting.simulation.data
        joint = setting.simulation.model.body(f"{SLAVE}/chassis").jntadr[0]
        address = setting.simulation.model.jnt_qposadr[joint]
        poses = []
        for tick in range(40):
            data.qpos[address] += 1e-3
            mujoco.mj_kinematics(setting.simulation.model, data)
            poses.append(transform_between(data, "slot", f"{SLAVE}/card"))
            late = tick - 25
            sent = None
            if late >= 0:
                covariance = 1e-6 * np.eye(6)
                # The master's clock is 3 s ahead.
                sent = Guidance(3.0 + 0.01 * late, True, True, poses[late], covariance)
            setting.team.master.sent = sent
            observations = {
                name: robot.observe()._replace(time=3.0 * (name == MASTER) + 0.01 * tick)
                for name, robot in setting.robots.items()
            }
            scorer.record(Tick(tick, 0.01 * tick, observations, {}))
        np.testing.assert_allclose(scorer.nees, 0.0, atol=1e-9)
        assert len(scorer.nees) == 15
        # A pose of now is 25 mm off.
        setting.team.master.sent = dataclasses.replace(sent, transform_slot_to_card=poses[-1])
        scorer.record(Tick(40, 0.4, observations, {}))
        assert scorer.nees[-1] > 50.0
