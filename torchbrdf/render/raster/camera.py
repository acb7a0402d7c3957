"""From where an object is seen, and where its vertices then are on the screen."""

import math
from dataclasses import dataclass

import numpy as np

from torchbrdf.errors import DataError, UsageError
from torchbrdf.render.raster.mesh import Mesh

# How much of the frame's width the bounding sphere takes, whatever the rotation, if no distance is asked for.
_FILL = 0.92


@dataclass(frozen=True)
class Camera:
    """A perspective camera that looks at the middle of an object.

    Args:
        rotation: Degrees about the vertical axis through the object; 0 looks from +z, 90 from +x.
        field_of_view: Of the whole frame, 1 to 120 degrees.
        elevation: Degrees above the horizon, from where the camera looks down, -89 to 89; below 0 it looks up.
        distance: Of the eye from the middle, in radii of the bounding sphere; None is as far as the field of view asks.

    Raises:
        UsageError: A number is out of its range.

    Example:
        >>> from torchbrdf.render import sphere
        >>> eye, axes = Camera(rotation=90, distance=2).pose(sphere(0))
        >>> eye.round(6).tolist()
        [2.0, 0.0, 0.0]
    """

    rotation: float = 0.0
    field_of_view: float = 30.0
    elevation: float = 0.0
    distance: float | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.rotation):
            raise UsageError(f"Camera.rotation: expected degrees, found {self.rotation}")
        if not 1 <= self.field_of_view <= 120:
            raise UsageError(f"Camera.field_of_view: expected 1 to 120 degrees, found {self.field_of_view}")
        if not -89 <= self.elevation <= 89:
            raise UsageError(f"Camera.elevation: expected -89 to 89 degrees, found {self.elevation}")
        if self.distance is not None and not 1 < self.distance < math.inf:
            raise UsageError(
                "Camera.distance: expected more than 1 radius of the bounding sphere, or the camera would be inside "
                f"the object, found {self.distance}"
            )

    def pose(self, mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
        """Where the camera stands before a mesh, and how it is turned.

        Returns:
            The eye `(3,)` in the units of the mesh, and the camera's axes as rows `(3, 3)`: right, up, and back from
            the object to the eye.

        Raises:
            DataError: All vertices are in one place.
        """
        center, radius = mesh.bounding_sphere
        if not radius > 0:
            raise DataError(f"{mesh.name}: expected a mesh with an extent, found {len(mesh.faces)} faces in one place")
        angle, height = math.radians(self.rotation), math.radians(self.elevation)
        sine, cosine = math.sin(angle), math.cos(angle)
        right = np.array([cosine, 0.0, -sine])
        up = np.array([-sine * math.sin(height), math.cos(height), -cosine * math.sin(height)])
        back = np.array([sine * math.cos(height), math.sin(height), cosine * math.cos(height)])
        distance = self.distance
        if distance is None:
            distance = 1 / math.sin(math.atan(_FILL * math.tan(math.radians(self.field_of_view) / 2)))
        return center + distance * radius * back, np.stack([right, up, back])

    def project(self, mesh: Mesh, size: int) -> np.ndarray:
        """Where vertices are in a picture of `size` x `size` pixels: column, row and closeness of each, `(3, V)`.

        Pixel (row, column) has its centre at exactly these numbers. Closeness is 1 / depth, which is linear on the
        screen along a triangle; all of the mesh is in front of the camera, so that it is positive.
        """
        eye, axes = self.pose(mesh)
        x, y, z = axes @ (mesh.vertices - eye).T
        closeness = -1 / z
        scale = size / (2 * math.tan(math.radians(self.field_of_view) / 2))
        middle = (size - 1) / 2
        return np.stack([middle + x * closeness * scale, middle - y * closeness * scale, closeness])
