"""Card and slot with their markers over a field, seen by a free stereo head, with the truth."""

import dataclasses
import math
from collections.abc import Callable

import cv2
import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from experiments.ch3.stereo.scene import HEAD
from experiments.ch5.insertion_scene import insertion_drawing
from models.card_and_slot.build import add_card, add_slot
from models.compose import FieldConfig, build_scene, compile_scene, load_part
from models.datasheets import CARD_AND_SLOT
from perception.geometry.arrays import FloatArray, ImageArray
from perception.markers.ellipses import MarkerExpectation, project_discs
from perception.markers.poses import BodyCad, BodyPrior
from twin.camera import StereoConfig, StereoRig, camera_pose, renderer

TABLE_HEIGHT = 0.4  # Height of card and slot over the ground [m].
RANGE_KNOWN = 0.2
"""How well the range is known before, as a part of it: map and dead reckoning are better."""
TILT_SIGMA = math.radians(2.0)
"""Deviation of the faces' normal where a prior is used: tilt sensor and the planar task."""
DISCS = "discs"
"""Paint of card and slot as the thesis has it; other paints are added to the scene."""
_SHOWN, _UNSEEN = 0, 4  # Groups of geoms: no camera shows the latter.


@dataclasses.dataclass(frozen=True)
class MarkerView:
    """A pair with its truth.

    Attributes:
        pair: (2, H, W) stereo pair, uint8.
        bodies: Transforms from card and slot to the left camera.
        ellipses: (2, 4, 5) true ellipses of the card's, then the slot's markers.
        distance: Distance of the view [m].
        slant: Angle of the view with the faces' normal [deg].
    """

    pair: ImageArray
    bodies: tuple[RigidTransform, RigidTransform]
    ellipses: FloatArray
    distance: float
    slant: float


def marker_cads(width: float) -> tuple[BodyCad, BodyCad]:
    """Return the CAD of the card and of a slot, whichever way up they are.

    Args:
        width: Width of the slot [m].
    """
    drawing = insertion_drawing(width)
    return BodyCad(drawing.card.points), BodyCad(drawing.slot.points)


def expectation(distance: float) -> MarkerExpectation:
    """Return what is expected of a view whose range is known to a fifth."""
    return MarkerExpectation(distance * (1.0 - RANGE_KNOWN), distance * (1.0 + RANGE_KNOWN))


def normal_prior(pose: RigidTransform, rng: np.random.Generator) -> BodyPrior:
    """Return the prior of a tilt sensor: two turns of a body to `TILT_SIGMA`, nothing else."""
    normal = pose.rotation.apply([0.0, 0.0, 1.0])
    level = np.eye(3) - np.outer(normal, normal)
    turned = Rotation.from_rotvec(level @ rng.normal(0.0, TILT_SIGMA, 3))
    information = np.zeros((6, 6))
    information[:3, :3] = level / TILT_SIGMA**2
    # Roughly its heading: two markers look the same upside down.
    information[:3, :3] += np.outer(normal, normal) / math.radians(30.0) ** 2
    guess = RigidTransform.from_components(pose.translation, turned * pose.rotation)
    return BodyPrior(guess, information)


class MarkerScene:
    """Card and slot over textured ground with rocks, before a free stereo head.

    Args:
        rng: Random generator for views and noise.
        noise_db: Signal-to-noise ratio of the images [dB].
        paint: Function that adds other paint to the scene's bodies ``card`` and ``slot``: geoms
            whose names begin with the paint's name and a slash, hidden until it is worn.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        noise_db: float | None = 46.0,
        paint: Callable[[mujoco.MjSpec], None] | None = None,
    ) -> None:
        self.width = CARD_AND_SLOT.slot_widths[1]
        self.geometry = HEAD
        self.cads = marker_cads(self.width)
        self._rng = rng
        seed = int(rng.integers(2**31))
        scene = build_scene(FieldConfig(size=(3.0, 3.0), rocks=150, blocks=10, seed=seed), ())
        poses = [
            scene.worldbody.add_body(name=f"{name}_stand", mocap=True) for name in ("card", "slot")
        ]
        add_card(scene, poses[0])
        add_slot(scene, poses[1], self.width)
        head = load_part("stereo_head")
        for geom in list(head.geoms):
            head.delete(geom)
        rig = scene.worldbody.add_body(name="rig", mocap=True)
        scene.attach(head, frame=rig.add_frame(), prefix="rig/")
        if paint is not None:
            paint(scene)
        self._model = compile_scene(scene)
        self._data = mujoco.MjData(self._model)
        self._rig = StereoRig(self._model, "rig/", StereoConfig(noise_db=noise_db))
        self.wear(DISCS)

    def wear(self, paint: str) -> None:
        """Show one paint of card and slot, and hide the others.

        Args:
            paint: `DISCS`, or the name of one that was added.
        """
        for index in range(self._model.ngeom):
            name = self._model.geom(index).name
            worn, _, rest = name.partition("/")
            if name.startswith(("card_marker", "slot_marker")):
                worn = DISCS
            elif not rest:
                continue
            self._model.geom_group[index] = _SHOWN if worn == paint else _UNSEEN

    def view(self, distance: float, slant: float) -> MarkerView:
        """Draw a pair.

        Args:
            distance: Distance from the cameras to the middle of card and slot [m].
            slant: Angle of the view with their faces' normal [deg].
        """
        rng = self._rng
        level = [0.0, 0.0, TABLE_HEIGHT]
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.05, 3))
        slot = RigidTransform.from_components(level, turn)
        gap = [rng.uniform(-0.01, 0.01), rng.uniform(-0.03, -0.005), rng.uniform(-0.004, 0.004)]
        bend = Rotation.from_rotvec(rng.normal(0.0, 0.05, 3))
        card = slot * RigidTransform.from_components(gap, bend)
        around, tilt = rng.uniform(-1.0, 1.0) - math.pi / 2.0, math.radians(slant) + 1e-3
        away = [math.sin(tilt) * math.cos(around), math.sin(tilt) * math.sin(around)]
        middle = slot.apply([0.0, 0.0, CARD_AND_SLOT.wall_height / 2.0])
        eye = middle + distance * turn.apply([*away, math.cos(tilt)])
        ahead = middle + rng.uniform(-0.02, 0.02, 3) * distance - eye
        roll = rng.uniform(-0.4, 0.4)
        upward = turn.apply([math.sin(roll), math.cos(roll), 0.0])
        right = np.cross(ahead, upward) / np.linalg.norm(np.cross(ahead, upward))
        ahead /= np.linalg.norm(ahead)
        axes = np.column_stack([right, np.cross(ahead, right), ahead])
        camera = RigidTransform.from_components(eye, Rotation.from_matrix(axes))
        self.place(slot, card, camera)
        return self._seen(distance, slant)

    def place(self, slot: RigidTransform, card: RigidTransform, camera: RigidTransform) -> None:
        """Place the bodies and the stereo head.

        Args:
            slot: Transform from the slot to the world.
            card: Transform from the card to the world.
            camera: Transform from the left camera to the world.
        """
        for name, pose in (("slot_stand", slot), ("card_stand", card)):
            self._put(name, pose)
        mount = self._model.camera("rig/stereo_left")
        self._put("rig", camera * RigidTransform.from_translation(mount.pos * [-1, 1, 1]))
        mujoco.mj_forward(self._model, self._data)

    def exact_pair(self, oversampling: int) -> FloatArray:
        """Return (2, H, W) grey levels without noise, integrated over each pixel's area.

        Args:
            oversampling: Number of rendered columns and rows of a pixel; each has four samples.
        """
        size = self.geometry.width, self.geometry.height
        images = []
        for eye in ("left", "right"):
            colour = renderer().render(
                self._model, self._data, f"rig/stereo_{eye}", *(oversampling * n for n in size)
            )
            grey = cv2.cvtColor(np.ascontiguousarray(colour), cv2.COLOR_RGB2GRAY)
            blocks = grey.reshape(size[1], oversampling, size[0], oversampling)
            images.append(blocks.mean(axis=(1, 3)))
        return np.stack(images)

    def bodies(self) -> tuple[RigidTransform, RigidTransform]:
        """Return the true transforms from card and slot to the left camera."""
        rotation, place = camera_pose(self._data, self._model.camera("rig/stereo_left").id)
        back = RigidTransform.from_components(place, Rotation.from_matrix(rotation)).inv()
        card, slot = (
            back
            * RigidTransform.from_components(
                body.xpos, Rotation.from_matrix(body.xmat.reshape(3, 3))
            )
            for body in (self._data.body("card"), self._data.body("slot"))
        )
        return card, slot

    def _put(self, name: str, pose: RigidTransform) -> None:
        if name == "rig":
            # The camera looks along the head's y, its rows run along -z.
            flip = Rotation.from_matrix([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
            pose = pose * RigidTransform.from_rotation(flip)
        index = self._model.body(name).mocapid[0]
        self._data.mocap_pos[index] = pose.translation
        self._data.mocap_quat[index] = pose.rotation.as_quat(scalar_first=True)

    def _seen(self, distance: float, slant: float) -> MarkerView:
        bodies, discs, normals = self.bodies(), [], []
        for pose, cad in zip(bodies, self.cads, strict=True):
            discs.append(pose.apply(cad.points))
            normals.append(np.tile(pose.rotation.apply(cad.normal), (len(cad.points), 1)))
        centres = np.concatenate(discs)
        eyes = np.stack([centres, centres - [self.geometry.baseline, 0.0, 0.0]])
        radius = CARD_AND_SLOT.marker_diameter / 2.0
        ellipses = project_discs(eyes, np.concatenate(normals)[None], radius, self.geometry)
        pair = self._rig.capture(self._data, (self._rng, self._rng))
        return MarkerView(pair, bodies, ellipses, distance, slant)
