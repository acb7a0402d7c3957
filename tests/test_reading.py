"""Reading what may hold anything: one line that names the file, or what is in it."""

import logging
import os
import zipfile

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from torchbrdf.errors import LONGEST_MESSAGE, LONGEST_WARNING, DataError, UsageError, one_line, shown
from torchbrdf.names import LONGEST_NAME, check_name, clean_name, file_stem
from torchbrdf.reading import CHECKSUM, read_bytes, read_json, read_npz, read_text, write_npz

ANY_TEXT = st.text(st.characters(), max_size=400)  # surrogates too


@given(ANY_TEXT)
def test_a_message_is_one_short_line_that_can_be_printed(text):
    for found in (str(DataError(text)), one_line(text), shown(text)):
        assert len(found) <= LONGEST_MESSAGE
        assert found.isprintable()
        found.encode()


def test_what_was_found_is_shown_whatever_it_is():
    nested = []
    for _ in range(100_000):
        nested = [nested]
    assert shown(nested) == "list"
    assert shown(10**5000) == "int"
    assert len(shown("x" * 10**8)) <= 60
    assert str(DataError("a.json: " + "x" * 999 + " tail")).endswith("tail")


@given(ANY_TEXT)
def test_a_cleaned_text_is_a_name_and_a_name_stays(text):
    name = clean_name(text)
    assert check_name(name, "here") == name
    assert os.sep not in name and len(name.encode()) <= LONGEST_NAME
    assert file_stem(name) == file_stem(name).strip()
    assert not set(file_stem(name)) & set('<>:"/\\|?*')


@pytest.mark.parametrize("name", ["", " ", ".", "..", "../x", "/x", "a\\b", "a\nb", "\x1b[31m", "a\0", "\ud800", None,
                                  ["a"], 1, "x" * 201])  # fmt: skip
def test_what_is_no_name_is_refused(name):
    with pytest.raises(DataError, match=r"^fits.json: expected a name"):
        check_name(name, "fits.json")


def test_different_names_have_different_files():
    names = ["a:b", "a_b", "a?b", "con", "con.x", "a.", "a"]
    assert len({file_stem(name) for name in names}) == len(names)
    assert file_stem("gold-metallic-paint2") == "gold-metallic-paint2"


@given(ANY_TEXT)
@example("con.x")
@example("NUL.tar.gz")
@example("con .x")
@example("a" * 199 + ":")
@example(":" + "\u00e9" * 100)
def test_the_stem_of_a_stem_is_itself(name):
    """So that nothing is hashed twice on its way to a file; and a device's name is none with a suffix either."""
    stem = file_stem(name)
    assert check_name(stem, "stem") == stem == file_stem(stem)
    assert stem.split(".")[0].strip().lower() not in ("con", "nul", "aux", "prn", "com1", "lpt1")


@pytest.mark.parametrize(
    "content",
    [b"", b"[" * 100_000, b"{", b'{"a": NaN}', b'{"a": "1"}', b'{"a": 1e999}', b'{"a": true}', b"[1]", b"\xff\xfe",
     b'{"\\ud800": 1}', b'{"a": ' + b"9" * 5000 + b"}"],
)  # fmt: skip
def test_json_that_is_not_of_its_type_is_refused(tmp_path, content):
    (tmp_path / "x.json").write_bytes(content)
    with pytest.raises(DataError, match=r"x\.json: expected numbers by name, found ") as caught:
        read_json(tmp_path / "x.json", dict[str, int], "numbers by name")
    assert len(str(caught.value)) <= LONGEST_MESSAGE


def test_only_regular_files_of_some_size_are_read(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "fifo")
    for path in (tmp_path / "fifo", tmp_path, tmp_path / "none", "/dev/zero", "a\0b"):
        with pytest.raises(DataError, match="expected data, found"):
            read_bytes(path, "data")
    (tmp_path / "x").write_bytes(b"\xef\xbb\xbfabc")
    assert read_text(tmp_path / "x", "text") == "abc"
    monkeypatch.setenv("TORCHBRDF_MAX_BYTES", "5")
    with pytest.raises(DataError, match="found 6; TORCHBRDF_MAX_BYTES raises the limit"):
        read_bytes(tmp_path / "x", "text")
    monkeypatch.setenv("TORCHBRDF_MAX_BYTES", "many")
    with pytest.raises(UsageError, match="expected a number of bytes"):
        read_bytes(tmp_path / "x", "text")


def test_arrays_come_back_or_are_refused(tmp_path):
    path = tmp_path / "x.npz"
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array([1, 2])}
    layout = {"a": ((None, 3), "f"), "b": ((2,), "i")}
    for compressed in (False, True):
        write_npz(path, arrays, compressed=compressed)
        found = read_npz(path, "numbers", layout)
        assert list(found) == ["a", "b"]
        assert all(np.array_equal(found[name], arrays[name]) for name in arrays)
    for wrong in ({"a": ((None, 4), "f")}, {"a": ((6,), "f")}, {"b": ((2,), "f")}, {"c": ((), "f")}):
        with pytest.raises(DataError, match=r"x\.npz: expected . of shape"):
            read_npz(path, "numbers", wrong)
    np.savez(path, **arrays)  # by someone else
    with pytest.raises(DataError, match="changed or damaged"):
        read_npz(path, "numbers")
    assert set(read_npz(path, "numbers", checksum=False)) == {"a", "b"}
    np.savez(path, a=np.array([object()]), **{CHECKSUM: np.zeros(32, np.uint8)})
    with pytest.raises(DataError, match=r"x\.npz: expected numbers, found"):
        read_npz(path, "numbers")
    write_npz(path, {"a": np.array([np.nan])})
    with pytest.raises(DataError, match="not finite"):
        read_npz(path, "numbers", {"a": ((None,), "f")})


def test_an_archive_that_unpacks_to_gigabytes_is_refused_by_its_header(tmp_path):
    path = tmp_path / "x.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("a.npy", "w", force_zip64=True) as one,
    ):
        for _ in range(1100):
            one.write(bytes(2**20))
    with pytest.raises(DataError, match="raises the limit"):
        read_npz(path, "numbers")


@given(st.binary(max_size=60), st.integers(0, 10**6))
def test_changed_bytes_are_refused_or_change_nothing(tmp_path_factory, junk, where):
    path = tmp_path_factory.mktemp("npz") / "x.npz"
    write_npz(path, {"a": np.arange(50.0)})
    data = bytearray(path.read_bytes())
    where %= len(data)
    data[where : where + len(junk)] = junk
    path.write_bytes(data)
    try:
        found = read_npz(path, "numbers", {"a": ((50,), "f")})
    except DataError as error:
        assert "x.npz" in str(error)
    else:
        assert np.array_equal(found["a"], np.arange(50.0))


def test_the_log_is_printable_whatever_a_file_is_called(caplog):
    logging.getLogger("torchbrdf").warning("torchbrdf: %s: %d bytes", "a\nb\x1b[31m" + "x" * 5000, 7)
    (said,) = caplog.messages
    assert said.isprintable() and said.startswith("torchbrdf: a b\\x1b[31mx") and said.endswith("7 bytes")
    assert len(said) <= LONGEST_WARNING
