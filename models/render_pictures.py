"""Make the pictures of the model folders again: ``python -m models.render_pictures``."""

import dataclasses
import os
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from models.braid.build import BraidConfig, build_rover
from models.card_and_slot.build import build_bench
from models.card_and_slot.guides import build_guides_bench
from models.compliant_base.build import XML as PLANT
from models.compose import FLAT, FOLDER, ROUGH, RobotPlacement, make_model, settle
from models.datasheets import CAMERA, CARD_AND_SLOT, CARD_GUIDE, DEGREE, MUSCLE_WIRE

WIDTH, HEIGHT = 640, 420
LARGEST = 200_000
"""Pictures in the repository stay below this size [bytes]."""

MAST_LONG = ("stage1_leg1", "stage2_leg1", "stage3_leg1", "stage4_leg2", "stage5_leg3")
"""Legs of BRAID that are long in its picture."""


@dataclasses.dataclass(frozen=True)
class Shot:
    """A view of a scene's middle.

    Attributes:
        lookat: (3,) point in the middle of the picture [m], world.
        distance: Distance from there to the eye [m].
        azimuth: Direction of view, from the world's x [deg].
        elevation: Direction of view, from the horizontal [deg].
        camera: Name of a camera of the model in place of the above.
    """

    lookat: tuple[float, float, float] = (0.0, 0.0, 0.0)
    distance: float = 1.0
    azimuth: float = 130.0
    elevation: float = -20.0
    camera: str = ""


def take(
    model: mujoco.MjModel, data: mujoco.MjData, shot: Shot, size: tuple[int, int]
) -> NDArray[np.uint8]:
    """Render one view.

    Args:
        model: Compiled model of a scene.
        data: State of the model.
        shot: Viewpoint of the picture.
        size: Width and height [px].

    Returns:
        (height, width, 3) uint8 RGB.
    """
    view = mujoco.MjvCamera()
    view.lookat[:] = shot.lookat
    view.distance, view.azimuth, view.elevation = shot.distance, shot.azimuth, shot.elevation
    with mujoco.Renderer(model, size[1], size[0]) as renderer:
        renderer.update_scene(data, shot.camera or view)
        return renderer.render().copy()


def write(image: NDArray[np.uint8], path: Path) -> None:
    """Write a PNG that stays small, with fewer grey levels where it has to be.

    Args:
        image: (height, width, 3) uint8 RGB.
        path: File to write.

    Raises:
        ValueError: If it cannot be made small enough.
    """
    for step in (1, 2, 4, 8, 16):
        coarse = (image // step) * step + step // 2
        bgr = cv2.cvtColor(coarse.astype(np.uint8), cv2.COLOR_RGB2BGR)
        done, data = cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        if done and data.nbytes < LARGEST:
            path.write_bytes(data.tobytes())
            return
    raise ValueError(f"{path.name}: {data.nbytes} bytes, more than {LARGEST} at 16 grey levels")


def main() -> None:
    """Render every picture into its model's folder."""
    flat = make_model(FLAT, [RobotPlacement()])
    rest = settle(flat)
    rough = make_model(
        ROUGH, [RobotPlacement(), RobotPlacement("rover2", (0.9, 0.5), 0.8, stereo=False)]
    )
    rough_rest = settle(rough)
    size = (WIDTH, HEIGHT)
    plant = mujoco.MjModel.from_xml_path(str(PLANT))
    plant_raised = mujoco.MjData(plant)
    plant_raised.qpos[6] = np.pi / 4
    mujoco.mj_forward(plant, plant_raised)
    bench = build_bench(CARD_AND_SLOT.slot_widths[1]).compile()
    askew = mujoco.MjData(bench)
    askew.qpos[:6] = (0.004, -0.02, 0.0, 0.0, 0.0, -6 * DEGREE)
    mujoco.mj_forward(bench, askew)
    guides = build_guides_bench(CARD_GUIDE.clearances[1]).compile()
    before = mujoco.MjData(guides)
    before.qpos[:2] = (0.0, -0.03)
    mujoco.mj_forward(guides, before)
    mast = build_rover(BraidConfig(5), FLAT, RobotPlacement()).compile()
    leaning = mujoco.MjData(mast)
    mujoco.mj_resetDataKeyframe(mast, leaning, mast.key("home").id)
    for name in MAST_LONG:
        leaning.actuator(f"rover1/{name}_extend").ctrl = MUSCLE_WIRE.heating
    mujoco.mj_step(mast, leaning, nstep=2200)
    leaning.ctrl[:] = 0.0
    mujoco.mj_step(mast, leaning, nstep=3000)
    pictures = {
        "braid/braid.png": take(mast, leaning, Shot((0.0, 0.05, 0.2), 1.0, 40.0, -15.0), size),
        "card_and_slot/card_and_slot.png": take(
            bench, askew, Shot((0.0, -0.03, 0.0), 0.26, 75.0, -50.0), size
        ),
        "card_and_slot/guides.png": take(
            guides, before, Shot((0.0, 0.0, 0.0), 0.24, 70.0, -35.0), size
        ),
        "compliant_base/compliant_base.png": take(
            plant, plant_raised, Shot((0.0, 0.15, 0.1), 1.7, 150.0, -18.0), size
        ),
        "rover/rover.png": take(flat, rest, Shot((0.0, 0.08, 0.1), 0.85, 150.0, -22.0), size),
        "arm/arm.png": take(flat, rest, Shot((0.0, 0.18, 0.17), 0.55, 170.0, -12.0), size),
        "field/field.png": take(
            rough, rough_rest, Shot((0.45, 0.3, 0.05), 2.2, 120.0, -25.0), size
        ),
        "stereo_head/stereo_head.png": take(
            rough, rough_rest, Shot(camera="rover1/stereo_left"), (CAMERA.width, CAMERA.height)
        ),
    }
    for name, image in pictures.items():
        write(image, FOLDER / name)
        print(FOLDER / name)


if __name__ == "__main__":
    main()
