"""Flexure hinges: how far a leg may bend before its material tires (Thesis eqs. E-1, E-2)."""

import dataclasses

import numpy as np

from controllers.braid.arm.stage import StageGeometry, leg_vectors, state_lengths, state_poses


@dataclasses.dataclass(frozen=True)
class Material:
    """Material of a flexure.

    Attributes:
        modulus: Young's modulus E [Pa].
        bendability: M, fatigue yield strength over Young's modulus.
    """

    modulus: float
    bendability: float


MATERIALS = {
    # M: Thesis E.2. E: assumption, the middle of handbook ranges.
    "ultra-high-molecular-weight polyethylene": Material(0.7e9, 3e-2),
    "polypropylene": Material(1.3e9, 3e-2),
    "nylon": Material(2.5e9, 3e-2),
    "spring steel": Material(205e9, 0.5e-2),
}


def greatest_thickness(length: float, angle: float, material: Material) -> float:
    """Return how thick a strip may be to bend by an angle again and again (E-1, E-2).

    Bent to a radius, length over angle, the outside of the strip is strained by its thickness over
    twice the radius; that must not exceed the bendability.

    Args:
        length: Length of the strip that bends [m].
        angle: Angle that it bends by [rad].
        material: Material of the strip.

    Raises:
        ValueError: If the angle is not positive.
    """
    if not angle > 0.0:
        raise ValueError(f"angle {angle}: expected more than 0")
    return 2.0 * material.bendability * length / angle


def stiffness(length: float, width: float, thickness: float, material: Material) -> float:
    """Return the torque by angle [N m/rad] of a strip as a beam, E w t^3 / (12 length).

    Args:
        length: Length of the strip that bends [m].
        width: Width of the strip along the hinge's axis [m].
        thickness: Thickness t of the strip [m].
        material: Material of the strip.
    """
    moment = width * thickness**3 / 12.0
    return material.modulus * moment / length


def joint_angles(geometry: StageGeometry) -> tuple[float, float]:
    """Return the greatest angles [rad] of legs to the axes of base and platform, in any state."""
    poses = state_poses(geometry)
    legs = leg_vectors(poses, geometry.radius) / state_lengths(geometry)[..., None]
    base = np.arccos(np.clip(legs[..., 2], -1.0, 1.0))
    normal = np.einsum("ski,si->sk", legs, poses[:, [5, 8, 11]])
    return float(base.max()), float(np.arccos(np.clip(normal, -1.0, 1.0)).max())
