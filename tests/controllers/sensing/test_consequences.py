"""What changes mean: bounds by the rover's weight, its motors and its arm as drawn."""

import dataclasses

import pytest

from controllers.sensing.consequences import Bounds, Consequence, consequence_of, reach, robot_mass
from controllers.sensing.diagnosis import UNKNOWN, Finding
from models.compose import RobotPlacement
from twin.describe import describe_rover
from twin.shadow.deviations import rover_deviations, shadow_scene

ROBOT = describe_rover("rover1")
GO_ON, SLOWER, STOP = Consequence


def consequence(name, size, sigma=0.0):
    return consequence_of(Finding(name, size, sigma, 9.0), ROBOT)


def test_mass_and_reach_are_those_of_the_model():
    model = shadow_scene(RobotPlacement("rover1"))
    assert robot_mass(ROBOT) == pytest.approx(float(model.body_mass.sum()), rel=1e-6)
    # Upper arm 0.2 m, forearm 0.18 m, and the wrist's end.
    assert 0.4 < reach(ROBOT) < 0.6  # noqa: PLR2004
    with pytest.raises(ValueError, match="has no arm"):
        reach(dataclasses.replace(ROBOT, arm=None))


@pytest.mark.parametrize(
    ("name", "sizes"),
    [
        ("load base", (0.4, 0.5, 2.2, 2.3)),  # of 4.5 kg
        ("spring rear_left", (-0.29, -0.31, -0.79, -0.81)),
        ("grip all", (-0.29, -0.31, -0.69, -0.71)),
        ("drag front_left", (0.65, 0.68, 3.3, 3.4)),  # of 6.66 N m
        ("supply elbow", (0.09, 0.11, 0.49, 0.51)),
        ("battery", (0.09, 0.11, 0.49, 0.51)),
        ("stuck wrist", (0.09, 0.11, 0.49, 0.51)),
        ("blocked rear_left", (0.09, 0.11, 0.49, 0.51)),
        ("zero wrist", (-0.019, 0.021, 0.099, -0.101)),
        ("loose camera", (0.0, 0.003, 0.008, 0.0101)),
        # 10.86 N m of the shoulder over 9.81 m/s^2 and the reach of 0.495 m are 2.23 kg.
        ("load gripper", (0.22, 0.23, 1.11, 1.13)),
    ],
)
def test_a_change_counts_by_its_size(name, sizes):
    assert [consequence(name, size)[0] for size in sizes] == [GO_ON, SLOWER, SLOWER, STOP]


def test_what_is_known_worse_counts_for_more():
    assert consequence("supply elbow", 0.08)[0] is GO_ON
    assert consequence("supply elbow", 0.08, sigma=0.05)[0] is SLOWER


def test_what_is_not_known_stops_the_rover():
    assert consequence(UNKNOWN, 0.0) == (STOP, "what changed is not known")


def test_every_change_of_a_rover_has_a_reason_that_names_its_part():
    for each in rover_deviations(ROBOT):
        if each.change > 0.0:
            _, why = consequence(each.name, each.change)
            part = each.name.partition(" ")[2].replace("_", " ")
            assert part in why


def test_bounds_are_as_given():
    finding = Finding("battery", 0.2, 0.0, 9.0)
    strict = Bounds(torque=(0.05, 0.15))
    assert consequence_of(finding, ROBOT, strict)[0] is STOP
