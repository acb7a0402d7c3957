"""What files hold, by label and by file name."""

import pytest

from torchbrdf.experiment.items import distinct_stems, list_items
from torchbrdf.lobes import FitRecord, Lambert, Sum, Ward, parameters, write_fits
from torchbrdf.measured import load_all
from torchbrdf.measured.load import number_repeats

DULL = parameters(Sum(Lambert(albedo=[0.3, 0.2, 0.1]), Ward(specular=0.1, roughness=0.4)))


def test_a_measurement_comes_before_its_stand_in(merl_file, tmp_path):
    fit = FitRecord("made-up", "ward", 1, DULL, loss="log", strategy="global")
    write_fits(tmp_path / "fits.json", [FitRecord("made-up", "ward", 1, DULL), fit, fit])
    items = list_items(load_all([tmp_path / "fits.json", merl_file]))
    assert [item.label for item in items] == [
        "made-up (stand-in)",
        "made-up: Ward, 1 lobe, log, global",
        "made-up: Ward, 1 lobe, log, global #2",
        "made-up (measured)",
    ]
    assert [item.reference for item in items] == [None, 3, 3, None]
    assert [item.stem for item in items] == [
        "made-up-stand-in",
        "made-up-ward-1-lobe-log-global",
        "made-up-ward-1-lobe-log-global-2",
        "made-up",
    ]


def test_labels_are_told_apart_by_numbers():
    assert number_repeats(["x", "y", "x", "x"], " #") == ["x", "y", "x #2", "x #3"]


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["x", "x", "x-2"], ["x", "x-2", "x-2-2"]),
        (["Nickel", "nickel"], ["Nickel", "nickel-2"]),  # one file where case does not count
        (["sheet"], ["sheet-2"]),
        (["../up", "/root", "a/b", ".hidden", ""], ["_up", "_root", "a_b", "hidden", "_"]),
        (["blau_grün+1", "<b>"], ["blau_grün+1", "_b_"]),
    ],
)
def test_file_names_do_not_collide_and_stay_in_their_folder(names, expected):
    assert distinct_stems(names, reserved=["sheet"]) == expected
