"""Every number of the models, in SI units, each with its source.

Sources are the thesis (by table, equation or appendix), a maker's data sheet, or "Assumption: ..."
where neither gives a value. The MJCF files have to hold literals; ``tests/models`` asserts on the
compiled model that each of them agrees with these modules, one for each subject. All names are
imported from here.

Body frame of a rover: x to the right, y forward, z up; its origin is the centre of gravity of the
rover without arm, above the middle of the wheelbase.
"""

from models.datasheets.arms import ARM, ROD_ARM, ArmSheet, RodArm
from models.datasheets.braid import BRAID, MUSCLE_WIRE, BraidSheet, MuscleWireSheet
from models.datasheets.card import (
    CARD_AND_SLOT,
    CARD_GUIDE,
    HAND,
    CardAndSlotSheet,
    CardGuideSheet,
    HandSheet,
)
from models.datasheets.clocks import CLOCK, HARSH_CLOCK, ClockSheet
from models.datasheets.motors import (
    ARM_MOTOR,
    POWER_STAGE,
    PULSE_CLOCK,
    ROVER_RATED_SPEED,
    WHEEL_MOTOR,
    WHEEL_RATED_SPEED,
    WHEEL_RATED_TORQUE,
    MotorSheet,
    PowerStageSheet,
    PulseClockSheet,
)
from models.datasheets.radio import HARSH_RADIO, RADIO, RadioSheet
from models.datasheets.rover import ROVER, RoverSheet
from models.datasheets.sensors import (
    CAMERA,
    CAMERA_CALIBRATION,
    FORCE_TORQUE,
    HARSH_SENSOR_ERRORS,
    INCLINOMETER,
    INCLINOMETER_CALIBRATION,
    LENS,
    POOR_CAMERA_CALIBRATION,
    SENSOR_ERRORS,
    CameraCalibrationSheet,
    CameraSheet,
    ForceTorqueSheet,
    InclinometerCalibration,
    InclinometerSheet,
    LensSheet,
    SensorErrorSheet,
)
from models.datasheets.tables import (
    TABLE_2_1_AVERAGE_ERROR,
    TABLE_2_1_CONSTANT,
    TABLE_2_1_TRUTH,
    TABLE_2_1_VARIABLE,
    TABLE_2_2_AVERAGE_ERROR,
    TABLE_2_2_CONSTANT,
    TABLE_2_2_TRUTH,
    TABLE_2_2_VARIABLE,
)
from models.datasheets.tolerances import EXACT, HARSH_TOLERANCES, TOLERANCES, Tolerances
from models.datasheets.units import DEGREE, INCH, OUNCE_INCH, RPM

__all__ = [
    "ARM",
    "ARM_MOTOR",
    "ArmSheet",
    "BRAID",
    "BraidSheet",
    "CAMERA",
    "CAMERA_CALIBRATION",
    "CARD_AND_SLOT",
    "CARD_GUIDE",
    "CLOCK",
    "CameraCalibrationSheet",
    "CameraSheet",
    "CardAndSlotSheet",
    "CardGuideSheet",
    "ClockSheet",
    "DEGREE",
    "EXACT",
    "FORCE_TORQUE",
    "ForceTorqueSheet",
    "HAND",
    "HARSH_CLOCK",
    "HARSH_RADIO",
    "HARSH_SENSOR_ERRORS",
    "HARSH_TOLERANCES",
    "HandSheet",
    "INCH",
    "INCLINOMETER",
    "INCLINOMETER_CALIBRATION",
    "InclinometerCalibration",
    "InclinometerSheet",
    "LENS",
    "LensSheet",
    "MUSCLE_WIRE",
    "MotorSheet",
    "MuscleWireSheet",
    "OUNCE_INCH",
    "POOR_CAMERA_CALIBRATION",
    "POWER_STAGE",
    "PULSE_CLOCK",
    "PowerStageSheet",
    "PulseClockSheet",
    "RADIO",
    "ROD_ARM",
    "ROVER",
    "ROVER_RATED_SPEED",
    "RPM",
    "RadioSheet",
    "RodArm",
    "RoverSheet",
    "SENSOR_ERRORS",
    "SensorErrorSheet",
    "TABLE_2_1_AVERAGE_ERROR",
    "TABLE_2_1_CONSTANT",
    "TABLE_2_1_TRUTH",
    "TABLE_2_1_VARIABLE",
    "TABLE_2_2_AVERAGE_ERROR",
    "TABLE_2_2_CONSTANT",
    "TABLE_2_2_TRUTH",
    "TABLE_2_2_VARIABLE",
    "TOLERANCES",
    "Tolerances",
    "WHEEL_MOTOR",
    "WHEEL_RATED_SPEED",
    "WHEEL_RATED_TORQUE",
]
