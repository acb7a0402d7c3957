"""What is drawn: triangle meshes with smooth normals; the sphere, and the project's own blob."""

import importlib.resources
import logging
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from torchbrdf.errors import DataError, ShapeError, UsageError, one_line, shown
from torchbrdf.files import replacing
from torchbrdf.render.raster.join import join
from torchbrdf.render.raster.mesh_formats import read_parts
from torchbrdf.render.raster.mesh_formats.ply import TANGENTS

# Of a normal: shorter level parts have no direction.
_LEVEL = 1e-9
# Of a tangent the share that has to lie in the surface.
_ALONG = 1e-4


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh with smooth normals. The vertical axis is +y.

    Args:
        vertices: `(V, 3)`, float64, in any unit.
        faces: Indices of the corners of each triangle, `(F, 3)`.
        normals: Unit vectors pointing outward, `(V, 3)`.
        name: What messages call it: the path of its file.
        tangents: Along the surface, `(V, 3)`, of any length: where the tangent of anisotropic materials lies, that of
            a growing u of texture coordinates as a rule. None, and a vector of 0 of a vertex: level around the
            vertical axis, to the right of who looks at the surface, see `level_tangents`.

    Raises:
        ShapeError: Shapes do not fit together, a face names no vertex, or a number is not finite.

    Example:
        >>> from torchbrdf.render import sphere
        >>> ball = sphere(levels=1)
        >>> ball.vertices.shape, ball.faces.shape
        ((18, 3), (32, 3))
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    name: str = field(default="mesh", compare=False)
    tangents: np.ndarray | None = None

    def __post_init__(self) -> None:
        shapes = [np.shape(array) for array in (self.vertices, self.faces, self.normals)]
        if any(len(shape) != 2 or shape[1] != 3 or not shape[0] for shape in shapes) or shapes[0] != shapes[2]:
            raise ShapeError(f"{self.name}: expected vertices (V, 3), faces (F, 3), normals (V, 3), found {shapes}")
        if self.tangents is not None and np.shape(self.tangents) != np.shape(self.vertices):
            raise ShapeError(f"{self.name}: expected tangents {shapes[0]}, found {np.shape(self.tangents)}")
        if not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise ShapeError(
                f"{self.name}: expected faces of vertices 0 to {len(self.vertices) - 1}, "
                f"found {self.faces.min()} to {self.faces.max()}"
            )
        given = [self.vertices, self.normals] if self.tangents is None else [self.vertices, self.normals, self.tangents]
        if not all(np.isfinite(array).all() for array in given):
            raise ShapeError(f"{self.name}: expected finite vertices, normals and tangents, found others")

    @classmethod
    def load(cls, path: str | Path) -> "Mesh":
        """Read a mesh from an OBJ, PLY, STL, OFF, glTF or GLB file.

        All parts of the file, each in its place, become one mesh. Normals of the file are kept; a vertex without one
        gets the mean of the triangles around its place. What is amiss is repaired, and said in the log: what no
        triangle refers to, faces without area and parts without faces are dropped; normals that are not of length 1
        are normalised; a closed mesh that is inside out is turned (of an open one that cannot be known, but both
        sides are drawn); and a vertex whose faces cancel takes the normal of one of them. Polygons become triangles.
        Texture coordinates of OBJ and PLY files give the tangents, which lie where u grows, unless a PLY file has
        tangents of its own: tx, ty and tz beside nx, ny and nz.
        Materials, textures, colours and smoothing groups are not read, nor bones. A glTF file whose triangles depend on
        more than its buffers and nodes (extensions, sparse accessors, weighted morph targets) is refused.

        Raises:
            DataError: The file is of another kind, cannot be read, holds no triangle with an area or more than
                5,000,000, or is smaller than 1e-9 or larger than 1e9 units, or 10,000 times its size away from the
                origin; or a buffer of a glTF file is not in its folder.
        """
        path = Path(path)
        found = join(path, read_parts(path, partial(_warn, path)), partial(_warn, path))
        return cls(found.vertices, found.faces, found.normals, str(path), found.tangents)

    def save(self, path: str | Path) -> None:
        """Write the mesh as a binary PLY with normals and, if it has some, tangents, in single precision.

        Args:
            path: Of the file, which ends in .ply. Tangents are its tx, ty and tz, which other programs pass over.

        Raises:
            UsageError: The name is that of another format; PLY is the only one here that has room for tangents.
        """
        if Path(path).suffix.lower() != ".ply":
            raise UsageError(f"{path}: expected a name that ends in .ply, found {shown(Path(path).suffix)}")
        names = ["x", "y", "z", "nx", "ny", "nz"]
        columns = [self.vertices, self.normals]
        if self.tangents is not None:
            names += TANGENTS
            columns.append(self.tangents)
        properties = "".join(f"property float {name}\n" for name in names)
        header = (
            f"ply\nformat binary_little_endian 1.0\nelement vertex {len(self.vertices)}\n{properties}"
            f"element face {len(self.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        )
        faces = np.empty(len(self.faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
        faces["count"], faces["corners"] = 3, self.faces
        vertices = np.hstack(columns).astype("<f4")
        with replacing(path) as temporary:
            temporary.write_bytes(header.encode() + vertices.tobytes() + faces.tobytes())

    def unit_tangents(self) -> np.ndarray:
        """Tangents of length 1, at right angles to normals, `(V, 3)`: the mesh's own, the level ones where none are.

        Example:
            >>> from torchbrdf.render import sphere
            >>> sphere(1).unit_tangents()[0]
            array([ 0.,  0., -1.])
        """
        level = level_tangents(self.normals)
        if self.tangents is None:
            return level
        own = self.tangents - (self.tangents * self.normals).sum(1, keepdims=True) * self.normals
        length = np.linalg.norm(own, axis=1, keepdims=True)
        none = length <= _ALONG * np.linalg.norm(self.tangents, axis=1, keepdims=True)
        return np.where(none, level, own / np.where(none, 1, length))

    @property
    def bounding_sphere(self) -> tuple[np.ndarray, float]:
        """Bounding sphere: the middle of the triangles' bounding box `(3,)`, and how far they reach from there."""
        there = np.zeros(len(self.vertices), bool)
        there[self.faces] = True
        used = self.vertices[there]
        center = (used.min(0) + used.max(0)) / 2
        return center, float(np.linalg.norm(used - center, axis=1).max())


def _warn(path: Path, repair: str) -> None:
    """Say what was amiss in a file and what was done about it."""
    logging.getLogger("torchbrdf").warning("torchbrdf: %s", one_line(f"{path}: {repair}"))


def sphere(levels: int = 6) -> Mesh:
    """Mesh of the unit sphere, with exact normals.

    Args:
        levels: How often the faces of an octahedron are divided; there are 8 * 4^levels faces.

    Example:
        >>> len(sphere(3).faces)
        512
    """
    vertices, faces = octahedral_sphere(levels)
    return Mesh(vertices, faces, vertices.copy(), name="sphere")


def level_tangents(normals: np.ndarray) -> np.ndarray:
    """Unit tangents that are level, around the vertical axis +y, of a surface with these normals.

    They are those of a sphere's parallels, as on a metal that was turned on a lathe. Where the surface is level itself
    they are +x.

    Args:
        normals: Unit vectors, `(..., 3)`.

    Example:
        >>> import numpy as np
        >>> level_tangents(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
        array([[ 0.,  0., -1.],
               [ 1.,  0.,  0.]])
    """
    x, z = normals[..., 0], normals[..., 2]
    length = np.hypot(x, z)
    none = length < _LEVEL
    safe = np.where(none, 1, length)
    return np.stack([np.where(none, 1, z / safe), np.zeros_like(x), np.where(none, 0, -x / safe)], -1)


def blob() -> Mesh:
    """Mesh of the bundled blob: convex and concave, so that it shows materials well.

    Such a shape told materials apart best in P. Vangorp et al., The Influence of Shape on the Perception of Material
    Reflectance, 2007, doi:10.1145/1275808.1276473. `torchbrdf.assets.make_blob` made it.
    """
    with importlib.resources.as_file(importlib.resources.files("torchbrdf.assets") / "blob.ply") as path:
        return replace(Mesh.load(path), name="blob")


def find_mesh(name: str) -> Mesh:
    """Mesh of a name: "blob", "sphere", or a file.

    Raises:
        DataError: The file is no mesh, or the name is empty.
    """
    if not name:
        raise DataError("mesh: expected blob, sphere or a file, found ''")
    made = {"blob": blob, "sphere": sphere}
    return made[name]() if name in made else Mesh.load(name)


def octahedral_sphere(levels: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices `(V, 3)` and faces `(8 * 4^levels, 3)` of an octahedron divided `levels` times, on the unit sphere."""
    vertices = np.vstack([np.eye(3), -np.eye(3)])
    faces = np.array([(x, y, z) if (x + y + z) % 2 else (x, z, y) for x in (0, 3) for y in (1, 4) for z in (2, 5)])
    for _ in range(levels):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges, index = np.unique(edges, axis=0, return_inverse=True)
        middles = vertices[edges].sum(1)
        ab, bc, ca = (len(vertices) + index.reshape(-1, 3)).T
        a, b, c = faces.T
        vertices = np.vstack([vertices, middles / np.linalg.norm(middles, axis=1, keepdims=True)])
        corners = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = np.concatenate([np.stack(corner, -1) for corner in corners])
    return vertices, faces
