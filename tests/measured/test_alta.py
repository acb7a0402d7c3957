"""ALTA's data: coordinates by their definitions, intervals, binary files, and what is refused."""

import numpy as np
import pytest
import torch
from helpers.listed_files import COLOR, alta, angles, known, unit_vectors

from torchbrdf.errors import DataError
from torchbrdf.images.primaries import REC709, XYZ, to_rec709
from torchbrdf.measured import describe, load
from torchbrdf.measured.alta_parameters import PARAMETERS


def written(folder, content, name="made-up.alta"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def light_and_viewer(rows):
    """Unit vectors of rows of angles in radians, `(N, 3)`."""
    both = unit_vectors(rows)
    return both[:, 3:], both[:, :3]


def half_and_difference(rows):
    """theta_h, phi_h, and theta_d, phi_d of the viewer, from dot products alone."""
    light, viewer = light_and_viewer(rows)
    half = light + viewer
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    theta_h, phi_h = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2]), np.arctan2(half[:, 1], half[:, 0])
    y = np.stack([-np.sin(phi_h), np.cos(phi_h), 0 * phi_h], -1)
    x = np.cross(y, half)
    along, across, up = ((viewer * axis).sum(-1) for axis in (x, y, half))
    return np.stack([theta_h, phi_h, np.arctan2(np.hypot(along, across), up), np.arctan2(across, along)], -1)


def h_and_b(rows):
    """H and B as ALTA has them, not normalized."""
    light, viewer = light_and_viewer(rows)
    return (light + viewer) / 2, (light - viewer) / 2


def azimuth_between(h, b):
    return np.arctan2(b[:, 1], b[:, 0]) - np.arctan2(h[:, 1], h[:, 0])


def stark(rows):
    h, b = h_and_b(rows)
    return np.stack([np.hypot(h[:, 0], h[:, 1]), np.linalg.norm(b, axis=-1), azimuth_between(h, b)], -1)


def neumann(rows):
    h, b = h_and_b(rows)
    return np.stack([np.hypot(h[:, 0], h[:, 1]), np.hypot(b[:, 0], b[:, 1]), azimuth_between(h, b)], -1)


def retro(rows):
    light, viewer = light_and_viewer(rows)
    between = (light * viewer).sum(-1)
    theta = np.arccos(np.clip(between, -1, 1))
    sines = np.maximum(np.sin(rows[:, 0]) * np.sin(theta), 1e-12)
    cosine = (viewer[:, 2] - light[:, 2] * between) / sines
    sine = np.sin(rows[:, 3] - rows[:, 1]) * np.sin(rows[:, 2]) / np.maximum(np.sin(theta), 1e-12)
    return np.stack([rows[:, 0], theta * cosine, theta * sine], -1)


def schlick(rows):
    light, viewer = light_and_viewer(rows)
    k = viewer + light * [-1, -1, 1]
    theta = np.arctan2(np.hypot(k[:, 0], k[:, 1]), k[:, 2])
    turn = np.arctan2(k[:, 1], k[:, 0]) - rows[:, 1]
    return np.stack([rows[:, 0], theta * np.cos(turn), theta * np.sin(turn)], -1)


def stereographic(rows):
    light, viewer = light_and_viewer(rows)
    return np.concatenate([one[:, :2] / (1 + one[:, 2:]) for one in (viewer, light)], -1)


FORWARD = {
    "CARTESIAN": unit_vectors,
    "SPHERICAL_TL_PL_TV_PV": lambda rows: rows,
    "STEREOGRAPHIC": stereographic,
    "RUSIN_TH_PH_TD_PD": half_and_difference,
    "RUSIN_TH_TD_PD": lambda rows: half_and_difference(rows)[:, [0, 2, 3]],
    "ISOTROPIC_TV_TL_DPHI": lambda rows: np.stack([rows[:, 2], rows[:, 0], rows[:, 1] - rows[:, 3]], -1),
    "ISOTROPIC_TL_TV_PROJ_DPHI": lambda rows: np.stack(
        [rows[:, 0], *(rows[:, 2] * f(rows[:, 3] - rows[:, 1]) for f in (np.cos, np.sin))], -1
    ),
    "RETRO_TL_TVL_PROJ_DPHI": retro,
    "SCHLICK_TL_TK_PROJ_DPHI": schlick,
    "STARK_3D": stark,
    "NEUMANN_3D": neumann,
}
# Of these the open angle is what the reader takes: light and viewer across, together, or light at the normal.
ACROSS = np.array(
    [(a, 40, a, 220) for a in range(0, 80, 5)] + [(a, 90 - b, a, b - 90) for a in (20, 50) for b in (5, 40)], float
)
TOGETHER = np.array([(a, 30, a, 30) for a in range(0, 85, 5)], float)
UP = np.array([(0, 0, a, b) for a in range(0, 85, 5) for b in (0, 130)], float)
OPEN = {
    "RUSIN_TH_PH_TD": (ACROSS, lambda rows: half_and_difference(rows)[:, :3]),
    "RUSIN_TH_TD": (ACROSS, lambda rows: half_and_difference(rows)[:, [0, 2]]),
    "COS_TH_TD": (ACROSS, lambda rows: np.cos(half_and_difference(rows)[:, [0, 2]])),
    "STARK_2D": (ACROSS, lambda rows: stark(rows)[:, :2]),
    "NEUMANN_2D": (ACROSS, lambda rows: neumann(rows)[:, :2]),
    "RUSIN_VH": (TOGETHER, lambda rows: light_and_viewer(rows)[0]),
    "COS_TH": (TOGETHER, lambda rows: np.cos(rows[:, :1])),
    "ISOTROPIC_TV_PROJ_DPHI": (UP, lambda rows: rows[:, 2:3] * np.stack([np.cos(rows[:, 3]), np.sin(rows[:, 3])], -1)),
    "COS_TLV": (UP, lambda rows: np.cos(rows[:, 2:3])),
    "COS_TLR": (UP, lambda rows: np.cos(rows[:, 2:3])),
}


def expected(measured):
    """The known BRDF where the values were read."""
    wi, wo = (one[0].numpy() for one in (measured.pairs.wi, measured.pairs.wo))
    theta_i, theta_o = (np.arctan2(np.hypot(one[:, 0], one[:, 1]), one[:, 2]) for one in (wi, wo))
    return known(theta_i, theta_o, np.arctan2(wo[:, 1], wo[:, 0]) - np.arctan2(wi[:, 1], wi[:, 0]))[:, None] * COLOR


def test_every_coordinates_are_tried():
    assert {*FORWARD, *OPEN} == {*PARAMETERS}


@pytest.mark.parametrize("name", PARAMETERS)
def test_coordinates_are_those_of_their_definitions(name, tmp_path):
    rows, place = (angles(lights=(10, 20, 40, 60)), FORWARD[name]) if name in FORWARD else OPEN[name]
    path = written(tmp_path, alta(rows, name=name, place=place))
    measured = load(path, dtype=torch.float64)
    good = measured.weight[0, :, 0].numpy() > 0
    assert good.mean() > 0.9 and len(good) == len(rows)
    np.testing.assert_allclose(measured.values[0].numpy()[good], expected(measured)[good], rtol=1e-6, atol=1e-9)
    said = describe(path)
    assert said["coordinates"] == name and ("incomplete" in said) == (name in OPEN)
    if name in OPEN:
        with pytest.raises(DataError, match=f"PARAM_IN {name}: expected coordinates that say all"):
            load(path, settings={"incomplete": "refuse"})


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("vs", [0, 1, 2])
def test_binary_files_are_as_text(order, vs, tmp_path):
    text = load(written(tmp_path, alta(vs=vs)), dtype=torch.float64)
    binary = load(written(tmp_path, alta(vs=vs, order=order), "b.alta"), dtype=torch.float64)
    torch.testing.assert_close(binary.values, text.values)
    assert describe(tmp_path / "b.alta").get("confidence intervals") == ("passed over" if vs else None)


def test_intervals_may_be_those_of_the_first_value(tmp_path):
    """As ALTA reads them from text."""
    lines = [line if line[0] == "#" else line + " 0.1" for line in alta().splitlines()]
    path = written(tmp_path, "\n".join(lines).replace("#VS 0", "#VS 1"))
    torch.testing.assert_close(load(path).values, load(written(tmp_path, alta(), "plain")).values)


def test_what_values_are(tmp_path):
    plain = load(written(tmp_path, alta(out="INV_STERADIAN")), dtype=torch.float64)
    cosine = load(written(tmp_path, alta(out="INV_STERADIAN_COSINE_FACTOR"), "cosine"), dtype=torch.float64)
    torch.testing.assert_close(cosine.values * cosine.pairs.cos_o[..., None], plain.values)
    xyz = load(written(tmp_path, alta(out="XYZ_COLOR"), "xyz"), dtype=torch.float64)
    rgb = load(written(tmp_path, alta(), "rgb"), dtype=torch.float64)
    back = torch.from_numpy(np.linalg.inv(to_rec709("", XYZ)))
    torch.testing.assert_close(xyz.values @ back.T, rgb.values)
    assert to_rec709("", REC709)[0, 0] == 1
    silent = alta().replace("#PARAM_OUT RGB_COLOR\n", "")
    assert describe(written(tmp_path, silent, "silent"))["values"] == "the file does not say (no PARAM_OUT)"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (alta().replace("#DIM 4 3", "#DIM 4"), "#DIM: expected two counts, found '4'"),
        (alta().replace("#DIM 4 3", "#DIM 3 4"), "DIM: expected 4 coordinates of SPHERICAL_TL_PL_TV_PV, found 3"),
        (alta().replace("#DIM 4 3", "#DIM 4 2"), "DIM: expected 3 values of 'RGB_COLOR', found 2"),
        (alta().replace("#VS 0", "#VS 2"), "expected 9 numbers, found 7"),
        (alta().replace("#VS 0", "#VS x"), "#VS: expected a count up to 2, found 'x'"),
        (alta().replace("SPHERICAL_TL_PL_TV_PV", "ROUND"), "PARAM_IN: expected coordinates of two directions"),
        (alta().replace("#PARAM_IN", "#X"), "found none: the file does not say what its numbers are"),
        (alta().replace("#VS 0", "#VS 0\n#DIM 3 3"), "#DIM: expected it once, found '4 3' and '3 3'"),
        (alta(order="little").replace(b"#ENDIAN little", b"#ENDIAN middle"), "ENDIAN little or big"),
        (alta(order="little").replace(b"#SAMPLE_COUNT ", b"#SAMPLE_COUNT 1"), "bytes of"),
        (alta(order="little")[:-900], "samples of 7 numbers, found"),
        (alta(order="little").replace(b"double", b"single"), "found 'binary ieee754-single little'"),
        ("#DIM 4 3\n#PARAM_IN CARTESIAN\n", "DIM: expected 6 coordinates of CARTESIAN, found 4"),
        ("#DIM 6 1\n#PARAM_IN CARTESIAN\n1 1 1 2 2 2 3\n", "expected valid samples above the horizon, found none"),
    ],
)  # fmt: skip
def test_bad_files_are_refused(content, says, tmp_path):
    with pytest.raises(DataError) as caught:
        load(written(tmp_path, content))
    assert says in str(caught.value) and "made-up.alta" in str(caught.value)


def test_real_samples(data):
    """A retro-reflector sends light back; a slice of a MERL table is where its table has it."""
    tape = load(data / "formats" / "alta" / "retro-gray-tape.dat", dtype=torch.float64)
    best = tape.values[0, :, 0].argmax()
    assert (tape.pairs.wi[0, best] * tape.pairs.wo[0, best]).sum() > 0.999
    felt = describe(data / "merl" / "pink-felt-1d.alta")
    assert felt["coordinates"] == "COS_TH" and felt["valid samples"] == 90
