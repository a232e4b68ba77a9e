"""Flexure hinges: how far a leg may bend before its material tires (Thesis eqs. E-1, E-2)."""

import dataclasses

import numpy as np

from controllers.braid.arm.stage import StageGeometry, rim_joints, state_lengths, state_poses


@dataclasses.dataclass(frozen=True)
class Material:
    """What a flexure is made of.

    Attributes:
        modulus: Young's modulus E [Pa].
        bendability: M, fatigue yield strength over Young's modulus.
    """

    modulus: float
    bendability: float

    @property
    def fatigue_strength(self) -> float:
        """Stress that it bears again and again [Pa]."""
        return self.modulus * self.bendability


MATERIALS = {
    # M: Thesis E.2. E: assumption, the middle of handbook ranges.
    "ultra-high-molecular-weight polyethylene": Material(0.7e9, 3e-2),
    "polypropylene": Material(1.3e9, 3e-2),
    "nylon": Material(2.5e9, 3e-2),
    "spring steel": Material(205e9, 0.5e-2),
}


@dataclasses.dataclass(frozen=True)
class Flexure:
    """A hinge milled as a thin strip.

    Attributes:
        length: Length of the strip that bends [m].
        width: Along the hinge's axis [m].
        thickness: t [m].
    """

    length: float
    width: float
    thickness: float

    def __post_init__(self) -> None:
        """Refuse what is no strip.

        Raises:
            ValueError: Naming the size.
        """
        for name in ("length", "width", "thickness"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} {getattr(self, name)}: expected a positive length")


def surface_strain(thickness: float, bend_radius: float) -> float:
    """Return the strain on the outside of a bent strip (E-1)."""
    return thickness / (2.0 * bend_radius)


def least_bend_radius(thickness: float, material: Material) -> float:
    """Return the smallest radius [m] that a strip [m] may be bent to (E-2)."""
    return thickness / (2.0 * material.bendability)


def greatest_angle(flexure: Flexure, material: Material) -> float:
    """Return how far a hinge may bend [rad] to either side: its strip bent to the least radius."""
    return flexure.length / least_bend_radius(flexure.thickness, material)


def greatest_thickness(length: float, angle: float, material: Material) -> float:
    """Return how thick a strip of a length [m] may be to bend by an angle [rad] again and again.

    Raises:
        ValueError: If the angle is not positive.
    """
    if not angle > 0.0:
        raise ValueError(f"angle {angle}: expected more than 0")
    return 2.0 * material.bendability * length / angle


def stiffness(flexure: Flexure, material: Material) -> float:
    """Return the torque by angle [N m/rad] of a strip as a beam, E w t^3 / (12 length)."""
    moment = flexure.width * flexure.thickness**3 / 12.0
    return material.modulus * moment / flexure.length


def joint_angles(geometry: StageGeometry) -> tuple[float, float]:
    """Return how far legs lean at most [rad] from the axes of base and platform, in any state."""
    joints = rim_joints(geometry.radius)
    poses = state_poses(geometry)
    rotation = poses[:, 3:].reshape(-1, 3, 3)
    legs = np.einsum("sij,kj->ski", rotation, joints) + poses[:, None, :3] - joints
    legs /= state_lengths(geometry)[..., None]
    base = np.arccos(np.clip(legs[..., 2], -1.0, 1.0))
    normal = np.einsum("ski,si->sk", legs, rotation[:, :, 2])
    return float(base.max()), float(np.arccos(np.clip(normal, -1.0, 1.0)).max())
