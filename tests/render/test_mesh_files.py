"""Files of meshes as other programs write them, and as they should not be."""

import logging
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.mesh_files import area, write

from torchbrdf.errors import DataError, ShapeError, TorchbrdfError
from torchbrdf.render import Camera, Environment, Mesh, Scene, find_mesh, sphere
from torchbrdf.render.raster.mesh_formats import part

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
# Quads of a cube with outward normals, by axis and side.
SIDES = [([0, 1, 3, 2], [-1, 0, 0]), ([4, 6, 7, 5], [1, 0, 0]), ([0, 4, 5, 1], [0, -1, 0]),
         ([2, 3, 7, 6], [0, 1, 0]), ([0, 2, 6, 4], [0, 0, -1]), ([1, 5, 7, 3], [0, 0, 1])]  # fmt: skip


FIRST = "v 0.0 0.0 0.0"


def cube_obj(shift: float = 0.0, first: int = 1, normals: int = 1, corner: str = "{v}//{n}") -> str:
    """A cube with flat normals, as OBJ; indices from `first` and `normals`."""
    lines = [f"v {x + shift} {y} {z}" for x, y, z in CORNERS] + [f"vn {x} {y} {z}" for _, (x, y, z) in SIDES]
    for n, (quad, _) in enumerate(SIDES):
        lines.append("f " + " ".join(corner.format(v=first + v, n=normals + n) for v in quad))
    return "\n".join(lines) + "\n"


def sharp(mesh: Mesh) -> bool:
    """Whether all normals are those of the triangles, as of a cube that is not smooth."""
    corners = mesh.vertices[mesh.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    return bool(np.allclose(mesh.normals[mesh.faces], flat[:, None], atol=1e-6))


# --- parts and normals ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", [("", ""), ("o a\nusemtl red\n", "o b\nusemtl green\n"), ("g a\n", "g b\ns off\n")])
def test_parts_of_an_obj_keep_their_normals(tmp_path: Path, names: tuple[str, str]) -> None:
    text = "mtllib there.is.none\n" + names[0] + cube_obj() + names[1] + cube_obj(3, 9, 7)
    mesh = Mesh.load(write(tmp_path / "two.obj", text))
    assert (len(mesh.vertices), len(mesh.faces)) == (48, 24)
    assert sharp(mesh)


def test_parts_of_a_glb_keep_their_normals_in_their_places(tmp_path: Path) -> None:
    """Normals go by the inverse transpose: they stay at right angles to a ball that is stretched and mirrored."""
    ball = trimesh.Trimesh(*(lambda m: (m.vertices, m.faces))(sphere(4)), process=False)
    ball.vertex_normals = sphere(4).normals
    scene, stretches = trimesh.Scene(), [np.array([2, 1, 0.5]), np.array([-1, 3, 1]), np.array([-1, -1, -1.0])]
    for k, stretch in enumerate(stretches):
        turn = trimesh.transformations.rotation_matrix(k, [1, 2, 3])
        matrix = trimesh.transformations.translation_matrix([10 * k, 0, 0]) @ turn @ np.diag([*stretch, 1])
        scene.add_geometry(ball, geom_name="ball", node_name=f"ball{k}", transform=matrix)
    scene.export(tmp_path / "balls.glb", include_normals=True)
    mesh = Mesh.load(tmp_path / "balls.glb")
    assert len(mesh.faces) == 3 * len(ball.faces)
    for k, stretch in enumerate(stretches):
        own = abs(mesh.vertices[:, 0] - 10 * k) < 5
        turn = trimesh.transformations.rotation_matrix(k, [1, 2, 3])[:3, :3]
        local = (mesh.vertices[own] - [10 * k, 0, 0]) @ turn
        np.testing.assert_allclose(np.linalg.norm(local / stretch, axis=1), 1, atol=1e-5)
        expected = local / stretch**2
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        np.testing.assert_allclose(mesh.normals[own] @ turn, expected, atol=1e-4)
    corners = mesh.vertices[mesh.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((flat * mesh.normals[mesh.faces].sum(1)).sum(1) > 0).all()  # corners go round the side of the normals


def test_a_part_without_normals_gets_means_and_the_other_keeps_its_own(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = cube_obj() + cube_obj(3, 9, 7, "{v}")
    mesh = Mesh.load(write(tmp_path / "mixed.obj", text))
    first = mesh.vertices[:, 0] < 2
    assert first.sum() == 24 and (~first).sum() == 8
    assert (abs(mesh.normals[first]).max(1) > 0.999).all()
    np.testing.assert_allclose(abs(mesh.normals[~first]), 1 / np.sqrt(3), atol=1e-9)
    assert "8 of 32 vertices have no normal in the file" in caplog.text


@pytest.mark.parametrize("odd", ["0 0 0", "nan 0 0", "inf 0 0"])
def test_a_normal_that_is_none_is_replaced_and_counted(
    tmp_path: Path, odd: str, caplog: pytest.LogCaptureFixture
) -> None:
    text = cube_obj().replace("vn -1 0 0", f"vn {odd}")
    mesh = Mesh.load(write(tmp_path / "cube.obj", text))
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-12)
    assert "4 of 24 vertices have no normal in the file" in caplog.text


@pytest.mark.parametrize("length", [1e-320, 1e-200, 0.5, 3.0, 1e200])
def test_normals_of_other_lengths_are_normalised_and_counted(
    tmp_path: Path, length: float, caplog: pytest.LogCaptureFixture
) -> None:
    text = cube_obj().replace("vn 1 0 0", f"vn {length} 0 0")
    assert sharp(Mesh.load(write(tmp_path / "cube.obj", text)))
    assert "4 of 24 normals in the file were not of length 1; normalised" in caplog.text


def test_corners_that_go_round_the_wrong_way_do_not_turn_the_normals_of_the_file(tmp_path: Path) -> None:
    lines = [
        " ".join(["f", *reversed(line.split()[1:])]) if line.startswith("f") else line
        for line in cube_obj().splitlines()
    ]
    assert sharp(Mesh.load(write(tmp_path / "cube.obj", "\n".join(lines))))


# --- what nothing refers to -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", ["100 0 0", "nan 0 0", "1e300 0 0"])
@pytest.mark.parametrize("ending", ["obj", "off", "ply"])
def test_stray_vertices_do_not_count(tmp_path: Path, place: str, ending: str, caplog: pytest.LogCaptureFixture) -> None:
    corners = "".join(f"{x} {y} {z}\n" for x, y, z in CORNERS)
    quads = [quad for quad, _ in SIDES]
    rows = "".join(f"4 {' '.join(map(str, quad))}\n" for quad in quads)
    head = "property float x\nproperty float y\nproperty float z\nelement face 6\nproperty list uchar int vertex_index"
    text = {
        "obj": f"v {place}\n" + cube_obj(0, 2, 1, "{v}"),
        "off": f"OFF 9 6 0\n{corners}{place}\n{rows}",
        "ply": f"ply\nformat ascii 1.0\nelement vertex 9\n{head}\nend_header\n{corners}{place}\n{rows}",
    }[ending]
    mesh = Mesh.load(write(tmp_path / f"cube.{ending}", text))
    center, radius = mesh.bounding_sphere
    np.testing.assert_allclose(center, 0.5)
    assert radius == pytest.approx(np.sqrt(0.75))
    assert len(mesh.vertices) == 8
    assert "1 of 9 vertices that no" in caplog.text


def test_stray_vertices_of_a_mesh_that_was_made_do_not_count() -> None:
    ball = sphere(2)
    more = np.vstack([ball.vertices, [[50.0, 0, 0]]])
    mesh = Mesh(more, ball.faces, np.vstack([ball.normals, [[1.0, 0, 0]]]))
    assert mesh.bounding_sphere[1] == pytest.approx(1)


# --- polygons, and odd lines of OBJ -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("outline", "expected"),
    [
        ([(0, 0), (1, 0), (1, 1), (0, 1)], 1.0),
        ([(0, 0), (2, 1), (0, 2), (1, 1)], 1.0),  # an arrow's head: only one corner sees it all
        ([(2, 1), (0, 2), (1, 1), (0, 0)], 1.0),
        ([(np.cos(t), np.sin(t)) for t in np.arange(5) * 2 * np.pi / 5], 2.37764),
        ([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], 3.0),  # an L
    ],
)
@pytest.mark.parametrize("ending", ["obj", "off", "ply"])
def test_polygons_become_triangles_that_fill_them(
    tmp_path: Path, outline: list[tuple[float, float]], expected: float, ending: str
) -> None:
    count = len(outline)
    corners = "".join(f"{x} {y} 0\n" for x, y in outline)
    rows = f"{count} {' '.join(map(str, range(count)))}\n"
    head = "property float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_index"
    binary = np.array([(*place, 0) for place in outline], ">f4").tobytes() + bytes([count])
    text: str | bytes = {
        "obj": "".join(f"v {line}\n" for line in corners.splitlines())
        + "f "
        + " ".join(str(k - count) for k in range(count)),
        "off": f"OFF\n# a comment\n{count} 1 0\n{corners}{rows}",
        "ply": f"ply\nformat binary_big_endian 1.0\nelement vertex {count}\n{head}\nend_header\n".encode()
        + binary
        + np.arange(count).astype(">i4").tobytes(),
    }[ending]
    mesh = Mesh.load(write(tmp_path / f"flat.{ending}", text))
    assert len(mesh.faces) == count - 2
    assert area(mesh) == pytest.approx(expected, abs=1e-4)


def test_rows_of_a_binary_ply_may_differ_and_other_elements_are_passed_over(tmp_path: Path) -> None:
    head = (
        "ply\r\nformat binary_little_endian 1.0\r\ncomment x\r\nelement camera 2\r\nproperty list uchar float t\r\n"
        "element vertex 4\r\nproperty double x\r\nproperty double y\r\nproperty double z\r\nproperty uchar red\r\n"
        "element face 2\r\nproperty uchar flag\r\nproperty list uchar uint vertex_indices\r\n"
        "property list uchar float texcoord\r\nend_header\r\n"
    )
    body = struct.pack("<Bf", 1, 0.5) + struct.pack("<B2f", 2, 0.5, 0.5)
    body += b"".join(struct.pack("<3dB", x, y, 0, 7) for x, y in [(0, 0), (1, 0), (1, 1), (0, 1)])
    body += struct.pack("<BB4IB2f", 1, 4, 0, 1, 2, 3, 2, 0, 0) + struct.pack("<BB3IB", 1, 3, 0, 1, 2, 0)
    mesh = Mesh.load(write(tmp_path / "odd.ply", head.encode() + body))
    assert len(mesh.faces) == 3 and area(mesh) == pytest.approx(1.5)


def test_indices_of_an_obj_count_from_the_end_of_what_there_is_so_far(tmp_path: Path) -> None:
    """What follows does not change what a line says."""
    text = "".join(cube_obj(shift, -8, -6) for shift in (0, 3, 6))
    mesh = Mesh.load(write(tmp_path / "cubes.obj", text))
    assert len(mesh.faces) == 36 and area(mesh) == pytest.approx(18) and sharp(mesh)


@pytest.mark.parametrize("corner", ["{v}", "{v}/1", "{v}/1/{n}", "{v}//{n}", "{v}/", "{v}//"])
def test_all_forms_of_a_corner(tmp_path: Path, corner: str) -> None:
    text = "# a cube\r\nvt 0 0\r\n" + cube_obj(corner=corner).replace("\n", "\r\n")
    mesh = Mesh.load(write(tmp_path / "cube.obj", text))
    assert len(mesh.faces) == 12 and sharp(mesh) == ("{n}" in corner)


def test_odd_lines_of_an_obj(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Colours and weights, comments, continued lines, names in no encoding, lines and points."""
    text = cube_obj().replace(FIRST, f"{FIRST} 1.0 0.5 0.5 # red").replace("f 1//1 2", "f 1//1 \\\n 2")
    data = text.encode() + b"o \xff\xfe\np 1\nl 1 2\nf 1 2\nwhat is this\n\n   \n#"
    mesh = Mesh.load(write(tmp_path / "cube.obj", data))
    assert len(mesh.faces) == 12 and sharp(mesh)
    said = "\n".join(caplog.messages)
    assert "left out 2 statements that are no faces (l, p)" in said
    assert "left out 1 of 7 faces with less than three corners" in said
    assert "ignored 1 lines that are no OBJ statements" in said


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ending", "text", "said"),
    [
        ("obj", cube_obj().replace(FIRST, FIRST[:-4]), "line 1: expected numbers of OBJ, found 'v 0.0 0.0'"),
        ("obj", cube_obj().replace("f 1//1", "f 1//x"), "line 15: expected numbers of OBJ"),
        ("obj", cube_obj().replace("f 1//1", "f 0//1"), "line 15: expected numbers of OBJ"),
        ("obj", cube_obj().replace("f 1//1", "f -9//1"), "line 15: expected numbers of OBJ"),
        ("obj", cube_obj().replace("f 1//1", "f 99//1"), "one of 8 vertex entries, found index 98"),
        ("obj", cube_obj().replace("f 1//1", "f 1//99"), "one of 6 normal entries, found index 98"),
        ("obj", cube_obj().replace("f 1//1", "f " + "9" * 5000), "line 15: expected numbers of OBJ"),
        ("obj", cube_obj().replace(FIRST, "v inf 0 0"), "3 of 24 that are not finite"),
        ("obj", cube_obj().replace(FIRST, "v 1e30 0 0"), "1e-09 to 1e+09 units, found 5e+29"),
        ("obj", cube_obj(1e7), "nearer to the origin than 10000 times its size 0.5"),
        ("obj", "v 0 0 0\nv 1 1 1\nv 2 2 2\n", "no faces"),
        ("obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "all vertices in one place"),
        ("off", "OFF\n3 1 0\n0 0 0\n1 0 0\n", "3 vertices and 1 faces, found 2 lines"),
        ("off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 x\n3 0 1 2\n", "expected numbers"),
        ("off", "OFF\n99999999999999999999 1 0\n0 0 0\n", "expected"),
        ("off", "4OFF\n", "expected OFF, COFF or NOFF"),
        ("ply", "ply\nformat ascii 1.0\nelement vertex 4000000000\nend_header\n", "header lines that fit the file"),
        ("ply", "ply\nformat ascii 1.0\nproperty float x\nend_header\n", "header lines that fit the file"),
        ("stl", "solid\nouter loop\nvertex 0 0 0\nvertex 1 0 zero\nvertex 0 1 0\nendloop\nendsolid", "readable mesh"),
        ("glb", b"glTF" + bytes(100), "expected a readable mesh"),
        ("gltf", "[]", "JSON that is a list"),
        ("gltf", "[" * 100_000, "expected a readable mesh"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, ending: str, text: str | bytes, said: str) -> None:
    path = write(tmp_path / f"mesh.{ending}", text)
    with pytest.raises(DataError, match=said.replace("+", r"\+")) as caught:
        Mesh.load(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message and len(message) <= 300


def test_an_empty_name_is_no_mesh_and_no_environment() -> None:
    with pytest.raises(DataError, match=r"^mesh: expected blob, sphere or a file, found ''$"):
        find_mesh("")
    with pytest.raises(DataError, match=r"^environment: expected grove, studio or a file, found ''$"):
        Environment.find("")


def test_archives_and_folders_are_no_meshes(tmp_path: Path) -> None:
    """A small archive may unpack to gigabytes: none is opened."""
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("mesh.obj", "v 0 0 0\n" * 2_000_000)
    (tmp_path / "folder.obj").mkdir()
    for name, said in (("bomb.zip", r"found a name that ends in '\.zip'"), ("folder.obj", "found"), ("", "found")):
        with pytest.raises(DataError, match=said):
            Mesh.load(tmp_path / name)


def test_meshes_have_at_most_so_many_triangles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part, "MOST_FACES", 11)
    with pytest.raises(DataError, match="expected at most 11 triangles, found 12 or more"):
        Mesh.load(write(tmp_path / "cube.obj", cube_obj()))


def test_what_cannot_be_seen_is_named_by_its_file(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1e-5 0 0\nv 0 1e-5 0\nv 1 1 1\nv 1.00001 1 1\nv 1 1.00001 1\nf 1 2 3\nf 4 5 6\n"
    path = write(tmp_path / "specks.obj", text)
    with pytest.raises(DataError, match=r"specks\.obj: nothing to see"):
        Scene(Mesh.load(path), Camera(), Environment.default(), size=4)


@pytest.mark.parametrize(
    "arrays",
    [
        (np.zeros((3, 2)), np.array([[0, 1, 2]]), np.zeros((3, 3))),
        (np.zeros((3, 3)), np.array([[0, 1, 3]]), np.zeros((3, 3))),
        (np.zeros((3, 3)), np.array([[0, 1, -1]]), np.zeros((3, 3))),
        (np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros((2, 3))),
        (np.full((3, 3), np.nan), np.array([[0, 1, 2]]), np.zeros((3, 3))),
        (np.zeros((3, 3)), np.zeros((0, 3), int), np.zeros((3, 3))),
    ],
)
def test_arrays_that_are_no_mesh(arrays: tuple[np.ndarray, ...]) -> None:
    with pytest.raises(ShapeError, match=r"^mesh: expected"):
        Mesh(*arrays)


def test_changed_files_are_refused_or_sound(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Bytes, numbers and lines that were changed at random."""
    caplog.set_level(logging.CRITICAL)
    generator = np.random.default_rng(0)
    ball = trimesh.creation.icosphere(1)
    ball.vertex_normals  # noqa: B018  # so that it is written
    whole = {ending: ball.export(file_type=ending) for ending in ("obj", "ply", "stl", "glb", "off")}
    accepted = 0
    for k in range(150):
        ending = [*whole][k % len(whole)]
        data = bytearray(whole[ending] if isinstance(whole[ending], bytes) else whole[ending].encode())
        for _ in range(generator.integers(1, 3)):
            at = int(generator.integers(len(data)))
            change = [b"nan", b" -1 ", b"9" * 12, b"\xff\xff\xff\x7f", b"\n", bytes([generator.integers(256)])]
            data[at : at + int(generator.integers(0, 5))] = change[generator.integers(len(change))]
        path = write(tmp_path / f"x.{ending}", bytes(data))
        try:
            mesh = Mesh.load(path)
        except TorchbrdfError as error:
            assert str(path) in str(error)
            continue
        accepted += 1
        assert np.isfinite(mesh.vertices).all() and np.allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-6)
        assert len(np.unique(mesh.faces)) == len(mesh.vertices)
    assert 10 < accepted < 140


def test_an_obj_without_faces_is_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """What was ignored is part of the error, and not said before it."""
    (tmp_path / "broken.obj").write_text("not a mesh\n")
    with pytest.raises(DataError, match=r"found no faces, but 1 lines that are no OBJ statements, the first of .* 1$"):
        find_mesh(str(tmp_path / "broken.obj"))
    assert not caplog.records
