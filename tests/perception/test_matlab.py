"""MAT files: the same matrices as scipy's reader finds, and one line for whatever else a file holds."""

import io
import random

import numpy as np
import pytest
from scipy.io import savemat

from torchbrdf.errors import DataError
from torchbrdf.perception import read_lagunas
from torchbrdf.perception.datasets.matlab import read_matrices

NAMES = ("rms", "rms_cos", "rms_cos_cube", "dist_L2_lab", "dist_L4_lab")


def mat(compressed=False, **matrices):
    file = io.BytesIO()
    savemat(file, matrices, do_compression=compressed)
    return file.getvalue()


@pytest.mark.parametrize("compressed", [False, True])
def test_matrices_are_those_that_were_saved(tmp_path, compressed):
    source = np.random.default_rng(0)
    wanted = {
        "a": source.normal(size=(3, 5)),
        "a_long_name_of_a_matrix": source.normal(size=(4, 2)).astype(np.float32),
        "counts": source.integers(0, 200, (2, 3)).astype(np.uint8),
        "empty": np.zeros((0, 3)),
        "one": np.array([[2.5]]),
        "large": source.integers(-(2**40), 2**40, (2, 2)),
    }
    others = {"text": "hello", "cell": np.array([1, "x", 2.5], object), "s": {"a": 1}, "z": np.ones((2, 2)) * 1j}
    (tmp_path / "x.mat").write_bytes(mat(compressed, **wanted, **others))
    found = read_matrices(tmp_path / "x.mat", wanted)
    assert list(found) == list(wanted)
    for name, matrix in wanted.items():
        np.testing.assert_array_equal(found[name], matrix)
        assert found[name].dtype == np.float64


@pytest.mark.parametrize("what", ["z", "text", "cell", "cube"])
def test_what_is_no_matrix_of_real_numbers_is_named(tmp_path, what):
    others = {
        "text": "hello",
        "cell": np.array([1, "x"], object),
        "z": np.ones((2, 2)) * 1j,
        "cube": np.ones((2, 2, 2)),
    }
    (tmp_path / "x.mat").write_bytes(mat(**others))
    with pytest.raises(DataError, match=rf"x\.mat: expected a MAT file of level 5 .*{what} that is no matrix of real"):
        read_matrices(tmp_path / "x.mat", [what])


@pytest.mark.parametrize("compressed", [False, True])
def test_no_damage_ends_the_process_or_gives_other_distances(tmp_path, compressed):
    """Changed bytes, cut ends and swapped stretches; scipy's reader, and Python with it, died of some."""
    rng, source = random.Random(1), np.random.default_rng(1)
    half = source.random((4, 4))
    data = mat(compressed, **dict.fromkeys(NAMES, half + half.T))
    path = tmp_path / "distances.mat"
    refused = 0
    for _ in range(1500):
        changed = bytearray(data)
        for _ in range(rng.choice([1, 1, 2, 8])):
            at = rng.randrange(len(changed))
            changed[at] = rng.choice([0, 1, 0x7F, 0xFF, rng.randrange(256)])
        path.write_bytes(changed[: rng.choice([len(changed), len(changed), rng.randrange(len(changed))])])
        try:
            found = read_lagunas(path, 4)
        except DataError as error:
            refused += 1
            assert str(path) in str(error) and len(str(error)) <= 300
        else:
            assert all(bool(((m >= 0) & m.isfinite() & (m == m.mT)).all()) for m in found.values())
    assert refused > 500


@pytest.mark.parametrize("bad", [np.nan, -1.0, np.inf, 9.0])
def test_distances_that_cannot_be_are_refused(tmp_path, bad):
    matrices = {name: np.ones((4, 4)) for name in NAMES}
    matrices["rms"][1, 2] = bad
    (tmp_path / "distances.mat").write_bytes(mat(**matrices))
    with pytest.raises(DataError, match="rms: expected finite distances of at least 0, the same both ways"):
        read_lagunas(tmp_path / "distances.mat", 4)
