"""What is drawn: triangle meshes with smooth normals; the sphere, and the project's own blob."""

import importlib.resources
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.errors import DataError


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh with smooth normals. The vertical axis is +y.

    Args:
        vertices: `(V, 3)`, float64, in any unit.
        faces: Indices of the corners of each triangle, `(F, 3)`.
        normals: Unit vectors pointing outward, `(V, 3)`.

    Example:
        >>> from torchbrdf.render import sphere
        >>> ball = sphere(levels=1)
        >>> ball.vertices.shape, ball.faces.shape
        ((18, 3), (32, 3))
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray

    @classmethod
    def load(cls, path: str | Path) -> "Mesh":
        """Read a mesh from any file that trimesh reads.

        Without normals in the file they are averaged over the faces around a vertex, vertices at one place merged.
        What is amiss is repaired, and said in the log: faces without area are dropped, a closed mesh that is inside
        out is turned (of an open one that cannot be known, but both sides are drawn), and a vertex without a normal,
        such as one whose faces cancel, takes that of one of its faces.

        Raises:
            DataError: The file cannot be read, or holds no triangle with an area.
        """
        import trimesh  # late, because it takes longer to import than the rest of this package

        path = Path(path)
        if not path.is_file():
            raise DataError(f"{path}: expected a mesh, found no such file")
        try:
            scene: Any = trimesh.load_scene(str(path), process=False)
            parts = scene.dump() if len(scene.graph.nodes_geometry) != 1 else [_only_part(scene)]
        except Exception as error:  # its readers raise whatever comes up in a damaged file
            raise DataError(f"{path}: not a readable mesh: {' '.join(str(error).split())}") from None
        every, parts = len(parts), [part for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
        if not parts:
            raise DataError(f"{path}: expected a mesh of triangles, found no faces")
        if len(parts) < every:
            _warn(path, f"left out {every - len(parts)} of {every} parts without faces")
        mesh: Any = parts[0] if len(parts) == 1 else trimesh.util.concatenate(parts)
        if not np.isfinite(mesh.vertices).all():
            raise DataError(f"{path}: a vertex is not finite")
        if not 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices):
            raise DataError(f"{path}: a face names vertex {mesh.faces.max()} of {len(mesh.vertices)}")
        with_area = mesh.area_faces > 0
        if not with_area.any():
            raise DataError(f"{path}: all {len(mesh.faces)} faces have no area")
        if not with_area.all():
            _warn(path, f"dropped {(~with_area).sum()} of {len(with_area)} triangles without area")
            mesh.update_faces(with_area)
        if "vertex_normals" not in mesh._cache:
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
        with np.errstate(invalid="ignore"):  # a flat mesh has no middle
            inside_out = mesh.is_watertight and mesh.volume < 0
        if inside_out:
            _warn(path, f"closed and inside out; turned its {len(mesh.faces)} triangles")
            mesh.invert()
        faces, normals = np.array(mesh.faces, np.int64), np.array(mesh.vertex_normals, np.float64)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        of_a_face = np.zeros_like(normals)
        of_a_face[faces] = mesh.face_normals[:, None]
        without = ~(length > 1e-6) & of_a_face.any(1, keepdims=True)
        if without.any():
            _warn(
                path, f"{without.sum()} of {len(normals)} vertices have no normal; each took that of one of its faces"
            )
        normals = np.where(length > 1e-6, normals / np.maximum(length, 1e-6), of_a_face)
        return cls(np.array(mesh.vertices, np.float64), faces, normals)

    def save(self, path: str | Path) -> None:
        """Write the mesh as a binary PLY with normals, single precision."""
        names = ("x", "y", "z", "nx", "ny", "nz")
        properties = "".join(f"property float {name}\n" for name in names)
        header = (
            f"ply\nformat binary_little_endian 1.0\nelement vertex {len(self.vertices)}\n{properties}"
            f"element face {len(self.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        )
        faces = np.empty(len(self.faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
        faces["count"], faces["corners"] = 3, self.faces
        vertices = np.hstack([self.vertices, self.normals]).astype("<f4")
        Path(path).write_bytes(header.encode() + vertices.tobytes() + faces.tobytes())

    @property
    def bounding_sphere(self) -> tuple[np.ndarray, float]:
        """Bounding sphere: the middle of the bounding box `(3,)`, and how far the mesh reaches from there."""
        center = (self.vertices.min(0) + self.vertices.max(0)) / 2
        return center, float(np.linalg.norm(self.vertices - center, axis=1).max())


def _warn(path: Path, repair: str) -> None:
    """Say what was amiss in a file and what was done about it."""
    logging.getLogger("torchbrdf").warning("torchbrdf: %s: %s", path, repair)


def _only_part(scene: Any) -> Any:
    """The one part of a scene in its place. dump() would do, but forgets the normals of the file."""
    transform, name = scene.graph[scene.graph.nodes_geometry[0]]
    return scene.geometry[name].apply_transform(transform)


def sphere(levels: int = 6) -> Mesh:
    """Mesh of the unit sphere, with exact normals.

    Args:
        levels: How often the faces of an octahedron are divided; there are 8 * 4^levels faces.

    Example:
        >>> len(sphere(3).faces)
        512
    """
    vertices, faces = octahedral_sphere(levels)
    return Mesh(vertices, faces, vertices.copy())


def blob() -> Mesh:
    """Mesh of the bundled blob: convex and concave, so that it shows materials well.

    Such a shape told materials apart best in P. Vangorp et al., The Influence of Shape on the Perception of Material
    Reflectance, 2007, doi:10.1145/1275808.1276473. `torchbrdf.assets.make_blob` made it.
    """
    with importlib.resources.as_file(importlib.resources.files("torchbrdf.assets") / "blob.ply") as path:
        return Mesh.load(path)


def find_mesh(name: str) -> Mesh:
    """Mesh of a name: "blob", "sphere", or a file.

    Raises:
        DataError: The file is no mesh.
    """
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
