"""How known fiducials appear to a stereo pair, for one pose or many at once, with derivatives.

What is known of the fiducials beforehand is Gaussian: their image points in an earlier view, or
their places in a map.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import point_jacobian
from perception.registration.checks import checked_image_points, checked_sigma
from perception.stereo.geometry import StereoGeometry


@dataclasses.dataclass(frozen=True)
class KnownPoints:
    """N fiducials as known beforehand.

    Attributes:
        coordinates: (N, 3) means: points [m], or columns, rows and disparities [px].
        covariance: (N, 3, 3) covariance of each, or (3N, 3N) joint covariance.
        geometry: Stereo pair that saw the coordinates, whose left camera is the frame; None if
            they are points.
    """

    coordinates: FloatArray
    covariance: FloatArray
    geometry: StereoGeometry | None = None

    def places(self, coordinates: FloatArray) -> FloatArray:
        """Return points (..., 3) [m] for coordinates (..., 3)."""
        return coordinates if self.geometry is None else self.geometry.points(coordinates)

    def place_jacobian(self, places: FloatArray) -> FloatArray:
        """Return (..., 3, 3), the derivatives of places by coordinates."""
        if self.geometry is None:
            return np.broadcast_to(np.eye(3), (*places.shape, 3))
        return np.asarray(np.linalg.inv(self.geometry.projection_jacobian(places)), dtype=float)

    def blocks(self) -> FloatArray:
        """Return (N, 3, 3), the covariance of each alone."""
        if self.covariance.ndim == 3:
            return self.covariance
        count = len(self.coordinates)
        split = self.covariance.reshape(count, 3, count, 3)
        return np.stack([split[i, :, i, :] for i in range(count)])

    def covariance_times(self, weights: FloatArray) -> FloatArray:
        """Return covariance times weights (N, 3)."""
        if self.covariance.ndim == 3:
            return (self.covariance @ weights[..., None])[..., 0]
        return (self.covariance @ weights.ravel()).reshape(-1, 3)

    def chosen(self, chosen: NDArray[np.bool_]) -> "KnownPoints":
        """Return some of them."""
        rows = np.repeat(chosen, 3)
        joint = self.covariance.ndim == 2
        kept = self.covariance[np.ix_(rows, rows) if joint else chosen]
        return KnownPoints(self.coordinates[chosen], kept, self.geometry)


@dataclasses.dataclass(frozen=True)
class Sighting:
    """Image points of N fiducials in one view.

    Attributes:
        image_points: (N, 3) columns, rows, disparities [px].
        sigma: (N, 3) standard deviations [px]; where it is `checked`, also one for all or (3,).
        geometry: Geometry of the stereo pair.
    """

    image_points: FloatArray
    sigma: FloatArray
    geometry: StereoGeometry

    def chosen(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "Sighting":
        """Return some of them, or sets of some."""
        return Sighting(self.image_points[chosen], self.sigma[chosen], self.geometry)

    def checked(self, name: str) -> "Sighting":
        """Return it as arrays of floats, with a deviation for each number.

        Args:
            name: Name of the points in errors.

        Raises:
            RegistrationError: If a shape is wrong, a number is not finite, or a disparity or a
                deviation is not positive.
        """
        points = checked_image_points(name, self.image_points)
        return Sighting(points, checked_sigma(self.sigma, len(points)), self.geometry)

    def noise(self) -> FloatArray:
        """Return (N, 3, 3) covariances [px^2]."""
        return np.eye(3) * (self.sigma**2)[..., None, :]

    def points(self) -> FloatArray:
        """Return (N, 3) triangulated points [m], left camera frame."""
        return self.geometry.points(self.image_points)

    def point_covariances(self) -> FloatArray:
        """Return (N, 3, 3) covariances of the triangulated points [m^2]."""
        return self.geometry.covariance(self.points(), self.sigma)

    def known(self) -> KnownPoints:
        """Return the fiducials as this view makes them known, each independently."""
        return KnownPoints(self.image_points, self.noise(), self.geometry)


@dataclasses.dataclass(frozen=True)
class Pose:
    """One pose, or many: from the camera into the frame of the known points.

    Attributes:
        rotation: (..., 3, 3).
        translation: (..., 3) [m].
    """

    rotation: FloatArray
    translation: FloatArray

    @classmethod
    def of(cls, transform: RigidTransform) -> "Pose":
        """Return a transform's parts."""
        return cls(transform.rotation.as_matrix(), np.asarray(transform.translation))

    def transform(self) -> RigidTransform:
        """Return it as a transform; one pose only."""
        return RigidTransform.from_components(self.translation, Rotation.from_matrix(self.rotation))

    def moved(self, xi: FloatArray) -> "Pose":
        """Return it moved by small xi (..., 6), in the frame of the known points."""
        turn = Rotation.from_rotvec(xi[..., :3].reshape(-1, 3)).as_matrix()
        turn = turn.reshape(self.rotation.shape)
        shifted = (turn @ self.translation[..., None])[..., 0] + xi[..., 3:]
        return Pose(turn @ self.rotation, shifted)


@dataclasses.dataclass(frozen=True)
class Linearised:
    """What is predicted at one pose or many, for N fiducials.

    Attributes:
        predicted: (..., N, 3) columns, rows, disparities [px]; NaN behind the camera.
        by_pose: (..., N, 3, 6) derivatives by xi.
        by_coordinates: (..., N, 3, 3) derivatives by the known points' coordinates.
    """

    predicted: FloatArray
    by_pose: FloatArray
    by_coordinates: FloatArray


def linearise(
    pose: Pose, coordinates: FloatArray, known: KnownPoints, geometry: StereoGeometry
) -> Linearised:
    """Predict how fiducials appear, with derivatives.

    Args:
        pose: One, or (...) many.
        coordinates: (..., N, 3) coordinates of the fiducials, as in `known`.
        known: Says what the coordinates are.
        geometry: Geometry of the stereo pair of the view.
    """
    places = known.places(coordinates)
    turned = np.swapaxes(pose.rotation, -1, -2)[..., None, :, :]
    seen = (places - pose.translation[..., None, :]) @ pose.rotation
    seen = np.where(seen[..., 2:] > 0.0, seen, np.nan)
    by_place = geometry.projection_jacobian(seen) @ turned
    return Linearised(
        geometry.project(seen),
        -by_place @ point_jacobian(places),
        by_place @ known.place_jacobian(places),
    )


def squared_distances(pose: Pose, known: KnownPoints, sight: Sighting) -> FloatArray:
    """Return (..., N) squared normalised residuals, chi-squared with 3 degrees for a true pose.

    Args:
        pose: One, or (...) many.
        known: N fiducials; each is judged alone.
        sight: Image points of the fiducials.
    """
    look = linearise(pose, known.coordinates, known, sight.geometry)
    residual, noise = _whitened(look, known.blocks(), sight)
    far = np.sum(residual * np.linalg.solve(noise, residual), axis=(-2, -1))
    return np.where(np.isfinite(far), far, np.inf)


def descend(pose: Pose, known: KnownPoints, sight: Sighting, iterations: int = 6) -> Pose:
    """Return many poses improved, each by its own fiducials; the places are not improved.

    Args:
        pose: (H,) poses.
        known: Coordinates (H, N, 3) and covariances (H, N, 3, 3).
        sight: Image points and deviations (H, N, 3).
        iterations: Number of Gauss-Newton steps.
    """
    for _ in range(iterations):
        look = linearise(pose, known.coordinates, known, sight.geometry)
        residual, noise = _whitened(look, known.covariance, sight)
        weighted = np.swapaxes(look.by_pose, -1, -2) @ np.linalg.inv(noise)
        information = np.sum(weighted @ look.by_pose, axis=-3)
        pull = np.sum(weighted @ residual, axis=-3)
        damping = 1e-9 * np.trace(information, axis1=-2, axis2=-1)[..., None, None] * np.eye(6)
        fine = np.isfinite(information).all(axis=(-2, -1), keepdims=True) & np.isfinite(pull).all(
            axis=(-2, -1), keepdims=True
        )
        step = np.linalg.solve(
            np.where(fine, information + damping, np.eye(6)), np.where(fine, pull, 0.0)
        )[..., 0]
        # Whatever turns further was sampled badly, and must not run away.
        step /= np.maximum(1.0, np.linalg.norm(step[..., :3], axis=-1, keepdims=True) / 0.5)
        pose = pose.moved(step)
    return pose


def _whitened(
    look: Linearised, blocks: FloatArray, sight: Sighting
) -> tuple[FloatArray, FloatArray]:
    """Return residuals (..., N, 3, 1) and covariances (..., N, 3, 3), finite."""
    residual = (sight.image_points - look.predicted)[..., None]
    by = look.by_coordinates
    noise = by @ blocks @ np.swapaxes(by, -1, -2) + sight.noise()
    fine = np.isfinite(noise).all(axis=(-2, -1), keepdims=True) & np.isfinite(residual).all(
        axis=(-2, -1), keepdims=True
    )
    return np.where(fine, residual, np.nan), np.where(fine, noise, np.eye(3))
