"""What files hold, by label and by file name."""

from dataclasses import replace

import pytest

from torchbrdf.experiment.items import list_items
from torchbrdf.experiment.labels import loss_label, model_label
from torchbrdf.lobes import GGX, FitRecord, Lambert, Sum, Ward, parameters, write_fits
from torchbrdf.measured import load_all
from torchbrdf.measured.load import number_repeats
from torchbrdf.names import distinct_stems

DULL = parameters(Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=0.1, roughness=0.4)))
MADE_UP = [("global", {}), ("", {"source": "somebody's measurement"})]


def test_a_measurement_comes_before_its_stand_in(merl_file, tmp_path):
    fit = FitRecord("made-up", "ward", 1, DULL, loss="log", strategy="global")
    write_fits(tmp_path / "fits.json", [FitRecord("made-up", "ward", 1, DULL), fit, replace(fit, diffuse="45:0")])
    items = list_items(load_all([tmp_path / "fits.json", merl_file]))
    assert [item.label for item in items] == [
        "made-up (stand-in)",
        "made-up: Ward, 1 lobe, log, global",
        "made-up: Ward, 1 lobe, log, global, diffuse held at 45:0",
        "made-up (measured)",
    ]
    assert [item.reference for item in items] == [None, 3, 3, None]
    assert [item.stem for item in items] == [
        "made-up-stand-in",
        "made-up-ward-1-lobe-log-global",
        "made-up-ward-1-lobe-log-global-2",
        "made-up",
    ]


def test_models_of_one_material_say_which_they_are(merl_file, tmp_path):
    """A model of what was measured, such as the zoo's, is no stand-in, and is compared with it."""
    lobes = parameters(Sum(Lambert(albedo=0.3), GGX(), GGX()))
    write_fits(tmp_path / "fits.json", [FitRecord("a", "ward", 1, DULL), FitRecord("a", "ggx", 2, lobes)])
    items = list_items(load_all([tmp_path / "fits.json", "zoo:nickel", "zoo:nickel:gltf"]))
    assert [(item.label, item.stem, item.reference) for item in items] == [
        ("a: Ward, 1 lobe (stand-in)", "a-ward-1-lobe", None),
        ("a: GGX, 2 lobes (stand-in)", "a-ggx-2-lobes", None),
        ("nickel: GGX, 2 lobes (model)", "nickel-ggx-2-lobes", None),
        ("nickel: glTF (model)", "nickel-gltf", None),
    ]
    made = [FitRecord("made-up", "ward", 1, DULL, strategy=how, extra=said) for how, said in MADE_UP]
    write_fits(tmp_path / "fits.json", made)
    assert [item.reference for item in list_items(load_all([tmp_path / "fits.json"]))] == [1, None]
    assert [item.reference for item in list_items(load_all([tmp_path / "fits.json", merl_file]))] == [2, 2, None]


def test_labels_are_told_apart_by_numbers():
    assert number_repeats(["x", "y", "x", "x"], " #") == ["x", "y", "x #2", "x #3"]
    assert number_repeats(["x", "x", "x-2", "x"], "-") == ["x", "x-2", "x-2-2", "x-3"]


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["x", "x", "x-2"], ["x", "x-2", "x-2-2"]),
        (["Nickel", "nickel"], ["Nickel", "nickel-2"]),  # one file where case does not count
        (["sheet"], ["sheet-2"]),
        (["gr\u00fcn", "gru\u0308n"], ["gr\u00fcn", "gru\u0308n-2"]),  # and where accents are written otherwise
        ([".hidden", "blau_grün+1", "gold $paint$"], ["hidden", "blau_grün+1", "gold $paint$"]),
    ],
)
def test_file_names_do_not_collide(names, expected):
    assert distinct_stems(names, reserved=["sheet"]) == expected


WICKED = [
    "../up",
    "/a/x",
    "a/b",
    "a_b",
    "",
    ".",
    "..",
    "con",
    "a:b",
    "x" * 300,
    "\x1b[31m",
    "a\nb",
    "\udcff",
    "\0",
    "<b>",
]


def test_whatever_a_name_is_its_file_stays_in_the_folder(tmp_path):
    stems = distinct_stems(WICKED)
    assert len({stem.casefold() for stem in stems}) == len(WICKED)
    for stem in stems:
        path = tmp_path / f"{stem}.png"
        assert path.parent == tmp_path and path.name == f"{stem}.png"
        path.touch()  # a name that the system takes
        assert stem.isprintable() and not stem.startswith(".")
    assert len([*tmp_path.iterdir()]) == len(WICKED)


def test_labels_are_made_in_one_place():
    assert [model_label(name) for name in ("abc", "ggx", "cook_torrance", "shifted_gamma")] == [
        "ABC", "GGX", "Cook-Torrance", "shifted gamma",
    ]  # fmt: skip
    assert loss_label("solid_angle_cosine_rms") == "solid-angle cosine RMS"
    assert loss_label("rendered_delta_e76") == "rendered ΔE 76"
