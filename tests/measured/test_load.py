"""Loading: formats by content, files and folders, and clear errors for everything else."""

import os
from pathlib import Path

import pytest
import torch
from helpers.measured_files import synthetic_bsdf, tensor_file

from torchbrdf.errors import DataError
from torchbrdf.measured import FORMATS, MERL_NAMES, MERL_SHA256, PAPER_TEN, Measured, is_merl, load, load_all, merl_name
from torchbrdf.names import check_name
from torchbrdf.pairs import Pairs


@pytest.fixture
def folder(tmp_path, merl_file):
    """Two MERL tables, one with a wrong suffix, an RGL file with none, and things to pass over."""
    place = tmp_path / "mixed"
    place.mkdir()
    os.link(merl_file, place / "b.binary")
    os.link(merl_file, place / "a.dat")
    (place / "felt_rgb").write_bytes(tensor_file(synthetic_bsdf()))
    (place / "notes.txt").write_text("notes")
    (place / "empty.txt").touch()
    (place / ".hidden.binary").write_text("no")
    (place / "folder.binary").mkdir()
    return place


def test_formats_are_told_by_content(folder):
    table, felt = load(folder / "a.dat"), load(str(folder / "felt_rgb"))
    assert (table.source.format, table.names) == ("merl", ["a"])
    assert (felt.source.format, felt.names) == ("rgl", ["felt"])
    assert table.dtype == torch.get_default_dtype()
    assert load(folder / "a.dat", dtype=torch.float64).diffuse_45_0().dtype == torch.float64


def test_a_mixed_folder_is_grouped_by_load_all_and_refused_by_load(folder):
    found = {measured.source.format: measured.names for measured in load_all(folder)}
    assert found == {"merl": ["a", "b"], "rgl": ["felt"]}
    with pytest.raises(DataError, match=r"found 2: .*a\.dat is merl, .*felt_rgb is rgl; load_all takes them all"):
        load(folder)


def test_several_files_keep_their_order_and_come_once(folder):
    measured = load([folder / "b.binary", folder / "a.dat", folder / ".." / "mixed" / "b.binary"])
    assert measured.names == ["b", "a"]
    assert measured.values.shape[0] == 2


def test_names_are_made_unique(tmp_path):
    paths = [
        tmp_path / "x" / "one" / "felt_rgb.bsdf",
        tmp_path / "two" / "felt.bsdf",
        tmp_path / "y" / "one" / "felt.bsdf",
    ]
    paths.append(tmp_path / "two" / "silk.bsdf")
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(tensor_file(synthetic_bsdf()))
    assert load(paths).names == ["one-felt", "two-felt", "one-felt-2", "silk"]


def test_one_bad_file_among_many_is_reported_and_the_others_are_done(folder):
    (folder / "cut.binary").write_bytes((folder / "a.dat").read_bytes()[:1000])
    (folder / "empty.bsdf").touch()
    (folder / "cut.bsdf").write_bytes((folder / "felt_rgb").read_bytes()[:1000])
    with pytest.raises(DataError, match=r"empty\.bsdf: the file is empty"):
        load_all(folder)
    bad = []
    found = load_all([folder, folder / "missing", folder / "notes.txt"], bad=bad)
    assert {measured.source.format: measured.names for measured in found} == {"merl": ["a", "b"], "rgl": ["felt"]}
    said = sorted(str(error).removeprefix(str(folder)).split(":")[0] for error in bad)
    assert said == ["/cut.binary", "/cut.bsdf", "/empty.bsdf", "/missing", "/notes.txt"]
    assert load_all([folder / "cut.bsdf"], bad=bad) == []


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: None, r"x: no such file or folder$"),
        (
            lambda path: path.mkdir(),
            r"x: expected measured BRDFs \(.*rgl \.bsdf.*\), found 0 files, none of",
        ),
        (lambda path: path.touch(), r"x: the file is empty; expected a measured BRDF"),
        (lambda path: path.write_text("hello world"), r"x: expected a measured BRDF .* begins with b'hello world'$"),
        (lambda path: path.symlink_to(path), r"x: no such file or folder$"),
        (os.mkfifo, r"x: not a file$"),
        (lambda path: path.write_bytes(b"tensor_file\0\x02\0"), r"x: truncated: the file ends inside its table"),
        (
            lambda path: path.write_bytes(b"tensor_file\0\x02\0\0\0\0\0"),
            r"x: expected an RGL file, b'tensor_file.*version 1\.0, .* 2\.0",
        ),
    ],
)
def test_bad_paths(tmp_path, make, says):
    make(tmp_path / "x")
    for loader in (load, load_all):
        with pytest.raises(DataError, match=says) as caught:
            loader(tmp_path / "x")
        assert "\n" not in str(caught.value)


def test_nothing_given():
    with pytest.raises(DataError, match="no file was given"):
        load([])


def test_a_folder_of_other_things(tmp_path):
    (tmp_path / "notes.txt").write_text("notes")
    with pytest.raises(DataError, match=r"found 1 files, none of them one"):
        load(tmp_path)


@pytest.mark.parametrize("stem", ["red\x1b[31m", "two\nlines", "a\\b", "x" * 240, os.fsdecode(b"gr\xfcn")])
def test_a_files_name_makes_a_name(tmp_path, stem):
    path = tmp_path / f"{stem}.bsdf"
    path.write_bytes(tensor_file(synthetic_bsdf()))
    (name,) = load(path).names
    assert check_name(name, "names") == name
    path.write_bytes(b"tensor_file")
    with pytest.raises(DataError) as caught:
        load(path)
    assert str(caught.value).isprintable() and len(str(caught.value)) <= 300


def test_names_of_samples_are_checked():
    angle = torch.tensor([[0.1, 0.2]])
    with pytest.raises(DataError, match=r"Measured: names: expected a name .*, found '\.\./x'"):
        Measured.from_samples(Pairs.from_half_diff(angle, angle, angle), torch.ones(1, 2, 3), names=["../x"])


def test_a_format_that_fails_names_the_file(tmp_path, monkeypatch):
    (tmp_path / "x.bsdf").write_bytes(tensor_file(synthetic_bsdf()))

    def fail(paths):
        raise KeyError("theta")

    monkeypatch.setattr(FORMATS["rgl"], "open", fail)
    with pytest.raises(
        DataError, match=r"x\.bsdf: expected a measured BRDF of the format rgl, found KeyError: 'theta'"
    ):
        load(tmp_path / "x.bsdf")


def test_unreadable(tmp_path, monkeypatch):
    (tmp_path / "x.bsdf").write_bytes(tensor_file(synthetic_bsdf()))

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(DataError, match=r"x\.bsdf: cannot be read: Permission denied"):
        load(tmp_path / "x.bsdf")
    with pytest.raises(DataError, match=r"x\.bsdf: cannot be read: Permission denied"):
        merl_name(tmp_path / "x.bsdf")


def test_every_format_says_what_it_is():
    for name, source in FORMATS.items():
        assert source.format == name
        assert source.__doc__
        assert not source.recognises(Path(__file__), b"\x89PNG\r\n\x1a\n" + bytes(56))


def test_catalogue(tmp_path):
    assert len(MERL_NAMES) == 100 == len(set(MERL_SHA256.values()))
    assert all(len(digest) == 64 and int(digest, 16) for digest in MERL_SHA256.values())
    assert len(PAPER_TEN) == 10
    assert set(PAPER_TEN) < set(MERL_NAMES)
    (tmp_path / "nickel.binary").write_bytes(b"not nickel")
    assert merl_name(tmp_path / "nickel.binary") is None
    assert not is_merl(tmp_path / "nickel.binary")


def test_catalogue_has_the_published_checksums(data):
    lines = (data / "merl" / "merl_sha256.txt").read_text().split("\n")
    published = dict(line.split()[::-1] for line in lines if line)
    assert {f"{name}.binary": digest for name, digest in MERL_SHA256.items()} == published


def test_a_file_of_merls_is_known_by_its_checksum(tmp_path, monkeypatch):
    (tmp_path / "any.name").write_bytes(b"abc")
    digest = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-2, appendix B.1
    monkeypatch.setattr("torchbrdf.measured.catalogue._NAMES", {digest: "nickel"})
    assert merl_name(tmp_path / "any.name") == "nickel"
    assert is_merl(tmp_path / "any.name")
