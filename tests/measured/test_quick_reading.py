"""What makes many small files quick to read: it reads what the slow ways read, and refuses what they refuse."""

import io
import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchbrdf.errors import DataError
from torchbrdf.measured import load, load_later, rows, summary
from torchbrdf.measured.rows import parse_rows
from torchbrdf.reading import npz_arrays

CELLS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.integers(-(10**20), 10**20).map(str),
    st.sampled_from(["1.", ".5", "+2", "nan", "inf", "-inf", "1e400", "1e-400", "00.5", "1_0", "", "x", "[1]", "1e5 ",
                     " 7", "true", "null", '1"', "0x1", "1E+3", "\u0661", "-0", "1,5", "2;5"]),
)  # fmt: skip


@given(
    st.lists(st.lists(CELLS, min_size=1, max_size=4), min_size=1, max_size=5), st.sampled_from([",", ";", "\t", " "])
)
def test_rows_are_the_same_however_they_are_read(cells, mark):
    lines = [mark.join(row) for row in cells]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rows, "_of_plain", lambda *_: None)
        slow = _rows_or_why(lines, len(cells[0]))
    quick = _rows_or_why(lines, len(cells[0]))
    assert type(quick) is type(slow)
    if isinstance(slow, str):
        assert quick == slow
    else:
        np.testing.assert_array_equal(quick, slow)


def _rows_or_why(lines, columns):
    try:
        return parse_rows(Path("x"), lines, columns, 1).numbers
    except DataError as error:
        return str(error)


def test_plain_rows_are_read_quickly(monkeypatch):
    monkeypatch.setattr(rows, "_of_any", None)
    np.testing.assert_array_equal(parse_rows(Path("x"), ["1,-2.5e-3", "3,4"], 2, 1).numbers, [[1, -2.5e-3], [3, 4]])
    np.testing.assert_array_equal(parse_rows(Path("x"), ["1,5;2", "3;4"], 2, 1).numbers, [[1.5, 2], [3, 4]])


ARRAYS = {
    "floats": np.linspace(0, 1, 7, dtype=np.float32),
    "by columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "none": np.empty((0, 3)),
    "one": np.array(2.5),
    "truths": np.array([True, False]),
    "words": np.array(["a", "bc"]),
    "big-endian": np.arange(3, dtype=">i4"),
    "complex": np.array([1 + 2j]),
    "records": np.zeros(2, dtype=[("a", "f4"), ("b", "i2")]),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_are_those_that_numpy_reads(save):
    file = io.BytesIO()
    save(file, **ARRAYS)
    found = npz_arrays("x", file.getvalue(), "arrays")
    assert list(found) == list(ARRAYS)
    for name, value in ARRAYS.items():
        np.testing.assert_array_equal(found[name], value)
        assert found[name].dtype == value.dtype
        assert found[name].flags.writeable


def _packed(member: bytes, name="a.npy") -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(name, member)
    return file.getvalue()


def _npy(value, **options) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, value, **options)
    return file.getvalue()


def test_arrays_of_later_versions_are_read():
    data = _packed(_npy(np.arange(3.0), version=(2, 0)))
    np.testing.assert_array_equal(npz_arrays("x", data, "arrays")["a"], [0, 1, 2])


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data[:-1],  # the end is missing
        lambda data: data[:50] + b"!" + data[51:],  # another byte: the checksum
        lambda data: b"PK\3\5" + data[4:],  # the member's own head
        lambda data: data.replace(b"a.npy", b"b.npy", 1),  # whose name is another's
        lambda data: data[:26] + struct.pack("<H", 60_000) + data[28:],  # and longer than the file
    ],
)
def test_damaged_archives_are_refused(change):
    data = _packed(_npy(np.arange(30.0)))
    npz_arrays("x", data, "arrays")
    with pytest.raises(DataError, match="x: expected arrays, found"):
        npz_arrays("x", change(data), "arrays")


@pytest.mark.parametrize(
    "member",
    [
        _npy(np.array([{}], dtype=object), allow_pickle=True),
        _npy(np.arange(30.0))[:-8],
        _npy(np.arange(30.0)).replace(b"(30,)", b"(99,)"),
        _npy(np.arange(30.0)).replace(b"(30,)", b"(-3,)"),
        _npy(np.arange(30.0)).replace(b"'<f8'", b"'<q9'"),
        _npy(np.arange(30.0))[:60],
        b"\x93NUMPY",
        b"some text",
    ],
)
def test_what_is_no_array_of_numbers_is_refused(member):
    with pytest.raises(DataError, match="x: expected arrays, found"):
        npz_arrays("x", _packed(member), "arrays")


def _write(folder: Path, name: str, theta, values, suffix=".csv"):
    columns = {"theta_i": theta, "theta_o": theta[::-1], "phi": np.full(len(theta), 3.0), "f": values}
    path = folder / f"{name}{suffix}"
    if suffix == ".npz":
        np.savez(path, **columns)
    else:
        np.savetxt(path, np.stack([*columns.values()], -1), delimiter=",", header=",".join(columns), comments="")
    return path


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_files_with_the_same_directions_read_as_each_alone(tmp_path, suffix):
    theta, other = np.linspace(0, 1.2, 8), np.linspace(0, 1.1, 8)
    twice = np.array([0.1, 0.1, 0.3, 0.4, 0.4, 0.3, 0.1, 0.1])
    values = np.linspace(0.1, 1, 8)
    holes = np.where(np.arange(8) < 3, np.nan, values)
    given = [(theta, values), (theta, holes), (other, values), (twice, values), (twice, values[::-1]), (theta, values)]
    paths = [_write(tmp_path, f"m{k}", *one, suffix) for k, one in enumerate(given)]
    together = load(paths)
    for k, path in enumerate(paths):
        alone = load(path)
        np.testing.assert_array_equal(together.values[k], alone.values[0])
        np.testing.assert_array_equal(together.weight[k], alone.weight[0])
        assert together.source.reading(k) == alone.source.reading(0)
    assert "repeated directions" in together.source.reading(3)
    assert "repeated directions" not in together.source.reading(0)


def test_repeated_directions_are_never_passed_over():
    generator = np.random.default_rng(0)
    for count in (1, 2, 50, 500):
        w = generator.normal(size=(2, count, 3))
        w /= np.linalg.norm(w, axis=-1, keepdims=True)
        assert not summary.are_any_repeated(*w)
        again = np.concatenate([w, w[:, -1:]], 1)
        assert summary.are_any_repeated(*again)
        assert summary.repeated(*again, np.arange(count + 1.0)[:, None] + 1)


def test_each_file_is_looked_at_once_while_files_are_listed(tmp_path, monkeypatch):
    module = sys.modules["torchbrdf.measured.find"]
    for k in range(60):
        _write(tmp_path, f"m{k:02d}", np.linspace(0, 1, 4), np.ones(4), ".npz")
    (tmp_path / "notes.txt").write_text("nothing")
    looked, compared = [], []
    monkeypatch.setattr(module, "_head", lambda path, inner=module._head: looked.append(path) or inner(path))
    equal = Path.__eq__
    monkeypatch.setattr(Path, "__eq__", lambda a, b: compared.append(1) or equal(a, b))
    (group,) = load_later([tmp_path, tmp_path / "m03.npz"])
    assert [*map(str, group.names)] == [f"m{k:02d}" for k in range(60)]
    assert len(looked) == 61
    assert len(compared) < 10 * 61  # not each with each


def test_what_copying_left_of_a_file_is_said_and_the_rest_is_listed(tmp_path):
    whole = _write(tmp_path, "a", np.linspace(0, 1, 4), np.ones(4), ".npz")
    (tmp_path / "b.npz").write_bytes(whole.read_bytes()[:-100])
    (tmp_path / "c.npz").touch()
    np.savez(tmp_path / "d.npz", weights=np.ones(3))  # somebody's, and whole: passed over
    (tmp_path / "e.txt").touch()
    bad = []
    (group,) = load_later([tmp_path], bad=bad)
    assert list(group.names) == ["a"]
    assert ["b.npz: expected a measured BRDF" in str(bad[0]), "archive that is damaged" in str(bad[0])] == [True] * 2
    assert "c.npz: the file is empty" in str(bad[1])
    assert len(bad) == 2


def test_links_in_a_folder_are_the_files_that_they_lead_to(tmp_path):
    (tmp_path / "a").mkdir()
    path = _write(tmp_path / "a", "m", np.linspace(0, 1, 4), np.ones(4))
    (tmp_path / "a" / "again.csv").symlink_to(path)
    (tmp_path / "b").symlink_to(tmp_path / "a")
    (group,) = load_later([tmp_path / "a", tmp_path / "b"])
    assert len(group) == 1
