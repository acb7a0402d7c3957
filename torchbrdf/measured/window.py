"""The XML files of LBNL's WINDOW and of Radiance: which scattering data they have, of which side and wavelengths."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, NamedTuple
from xml.parsers import expat

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.bands import LONGEST
from torchbrdf.measured.gridded import GriddedFormat
from torchbrdf.measured.listed import QUANTITIES
from torchbrdf.measured.rows import head_lines
from torchbrdf.reading import check_unpacked, read_bytes

EXPECTED = "a BSDF XML file of WINDOW or Radiance"
BANDS = ("visible", "solar", "nir")
# What `band` may be beside these: all that have a wavelength of their own.
SPECTRAL = "spectral"
# Nanometers in a unit, in which a wavelength is unless it says another.
_UNITS = {"micrometer": 1e3, "micron": 1e3}
_LENGTH = re.compile(r"(\d+(?:\.\d*)?) ?(?:nm)?")
_ROOT = re.compile(r"<(?:[\w.-]+:)?WindowElement\b")
_TREE = re.compile(rb"IncidentDataStructure[^<>]*>\s*TensorTree", re.IGNORECASE)
# An element whose beginning Radiance's wrapBSDF of 2015 wrote without its first character.
_CUT = re.compile(rb"(?<![</\w])SourceSpectrum>")
# Lines of what a program said, as genBSDF does, in front of a file that it wrote to its output.
_LINES_IN_FRONT = 5
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf(?:inity)?)", re.IGNORECASE)
# Of a number while it is read: a text and a number of Python's.
_BYTES_A_NUMBER = 100
# Elements within each other; files have nine.
_DEEPEST = 64


class Block(NamedTuple):
    """Scattering data: from which side light comes and whether it goes through, in which band, of which layer.

    A band is a name, or a wavelength in nm, which `length` has, too.
    """

    direction: str
    band: str
    layer: str
    length: float | None
    element: ET.Element

    def said(self, name: str) -> str:
        """The text of an element within; "" where there is none."""
        return text_of(self.element, name)


class Document(NamedTuple):
    """What a file says: its definition of data, its blocks, what it calls the material, and what was mended."""

    structure: str
    definition: ET.Element
    blocks: list[Block]
    material: str
    mended: str


class Chosen(NamedTuple):
    """The blocks that are read, by band, and how they were chosen, by name."""

    side: str
    blocks: dict[str, Block]
    wavelengths: list[float] | None
    facts: dict[str, object]


class WindowFormat(GriddedFormat):
    """Base of the two kinds of these files. Only a reflection is read, from the front or from the back.

    The frame of the front is the file's, seen from there, with its y the other way round, so that it is right-handed;
    Radiance calls that side the back.

    Attributes:
        colors: The bands that are read together where all are there, as colours; one is the visible band, which is Y.
        has_spectra: Whether bands with wavelengths are read.
    """

    colors: ClassVar[tuple[str, ...]]
    has_spectra: ClassVar[bool] = False
    settings: ClassVar = {"side": ("auto", "front", "back"), "band": ("auto", *BANDS), "quantity": QUANTITIES}

    def chosen(self, path: Path, document: Document) -> Chosen:
        """The blocks of one side, and how that was decided."""
        found: dict[tuple[str, str], Block] = {}
        for block in document.blocks:
            if (block.direction, block.band) in found and block.direction.startswith("reflection"):
                raise DataError(f"{path}: expected one {block.direction} of the band {block.band}, found several")
            found[block.direction, block.band] = block
        there = list(dict.fromkeys(block.direction for block in document.blocks))
        words = ", ".join(there) or "no scattering data"
        sides = [side for side in ("front", "back") if f"reflection {side}" in there]
        if not sides:
            raise DataError(f"{path}: expected a reflection, found only {shown(words)}")
        told = self.setting("side", "auto")
        side = sides[0] if told == "auto" else told
        if side not in sides:
            raise DataError(f"{path}: expected reflection {side}, found {shown(words)}")
        own = {band: block for (direction, band), block in found.items() if direction == f"reflection {side}"}
        names = self._bands(path, side, own)
        rest = [name for name in own if name not in names]
        facts: dict[str, object] = {"material": shown(document.material)} if document.material else {}
        more = "" if told == side else "; --read side=front, side=back"
        facts["side"] = f"{side}; the file has {shown(words, 120)}{more}"
        facts["band"] = ", ".join(names) + (f"; passed over: {shown(', '.join(rest))}" if rest else "")
        if document.mended:
            facts["mended"] = document.mended
        blocks = {name: own[name] for name in names}
        kind = blocks[names[0]].said("ScatteringDataType")
        if kind.upper() not in ("", "BRDF"):
            facts["kind"] = f"the block says {shown(kind)}, its direction reflection; the direction was believed"
        lengths = [block.length for block in blocks.values() if block.length is not None]
        return Chosen(side, blocks, lengths or None, facts)

    def _bands(self, path: Path, side: str, there: Mapping[str, Block]) -> list[str]:
        """The bands that are read: one, those that make colours, or all with wavelengths, growing."""
        told = self.setting("band", "auto")
        known = [band for band in BANDS if band in there]
        lengths = {name: block.length for name, block in there.items() if block.length is not None}
        if self.has_spectra and lengths and (told == SPECTRAL or (told == "auto" and not known)):
            return sorted(lengths, key=lambda name: lengths[name])
        band = known[0] if told == "auto" and known else told
        if band not in known:
            wanted = told if told != "auto" else f"one of {', '.join(BANDS)}"
            raise DataError(f"{path}: reflection {side}: expected the band {wanted}, found {shown(', '.join(there))}")
        return list(self.colors) if band == "visible" and set(self.colors) <= set(there) else [band]


def is_window(path: Path, head: bytes) -> bool:
    """Whether a file is one of these, by its root."""
    lines = head_lines(path, head)
    at = next((k for k, line in enumerate(lines[: _LINES_IN_FRONT + 1]) if line.startswith("<")), None)
    return at is not None and any(_ROOT.search(line) for line in lines[at:])


def is_tree(path: Path) -> bool:
    """Whether one of these files holds a tensor tree."""
    return _TREE.search(read_bytes(path, EXPECTED)) is not None


def read_window(path: Path) -> Document:
    """What a file says.

    Raises:
        DataError: It is no such file. Entities, which can blow up, are none of theirs: no document type is read.
    """
    root, mended = _parsed(path)
    layers = [one for one in root.iter("Layer") if one.find("WavelengthData") is not None]
    if root.tag != "WindowElement" or len(layers) != 1:
        raise DataError(
            f"{path}: expected {EXPECTED}, with data of one Layer, found {len(layers)} in {shown(root.tag)}"
        )
    (layer,) = layers
    definition = layer.find("DataDefinition")
    if definition is None:
        raise DataError(f"{path}: expected an element DataDefinition, found none")
    blocks = [
        Block(_plain(text_of(block, "WavelengthDataDirection")), *_band(path, data), block)
        for data in layer.findall("WavelengthData")
        for block in data.findall("WavelengthDataBlock")
    ]
    # Layers of a system may have data of their own.
    whole = {(block.direction, block.band) for block in blocks if block.layer == "system"}
    blocks = [one for one in blocks if one.layer == "system" or (one.direction, one.band) not in whole]
    structure, material = text_of(definition, "IncidentDataStructure"), text_of(layer, "Material/Name")
    return Document(structure, definition, blocks, material, mended)


def _band(path: Path, data: ET.Element) -> tuple[str, str, float | None]:
    """The band of some data, the layer that they are of, and the wavelength in nm, if it is one."""
    name, layer = _plain(text_of(data, "Wavelength")), _plain(text_of(data, "LayerNumber"))
    said = _LENGTH.fullmatch(name)
    if said is None:
        return name, layer, None
    element = data.find("Wavelength")
    unit = "" if element is None else element.get("unit", "").lower().removesuffix("s")
    length = float(said[1]) * _UNITS.get(unit, 1.0)
    if not 0 < length < LONGEST:
        raise DataError(f"{path}: Wavelength: expected a name, or one in nm, found {shown(name)}")
    return f"{length:g} nm", layer, length


def _plain(text: str) -> str:
    return " ".join(text.lower().split())


def text_of(element: ET.Element, name: str) -> str:
    """The text of an element within another, stripped; "" where there is none."""
    return (element.findtext(name) or "").strip()


def numbers(path: Path, where: str, text: str) -> np.ndarray:
    """Numbers that blanks or commas part.

    Raises:
        DataError: Something else is among them, or they are too many.
    """
    check_unpacked(path, _BYTES_A_NUMBER * (sum(map(text.count, " ,\t\n\r")) + 1))
    words = text.replace(",", " ").split()
    try:
        if "_" in text:  # which Python allows
            raise ValueError
        return np.array(list(map(float, words)), dtype=np.float64)
    except ValueError:
        bad = next((word for word in words if not _NUMBER.fullmatch(word)), text)
        raise DataError(f"{path}: {where}: expected numbers, found {shown(bad)}") from None


def _parsed(path: Path) -> tuple[ET.Element, str]:
    """The elements of a file, without prefixes of namespaces, and what was mended."""
    data = read_bytes(path, EXPECTED)
    mended = []
    said, mark, rest = data.partition(b"<")
    in_front = said.removeprefix(b"\xef\xbb\xbf").strip()
    if mark and in_front and b"\0" not in said:
        data = mark + rest
        mended.append(f"text in front of the XML passed over: {shown(in_front.decode('latin-1'), 60)}")
    data, cut = _CUT.subn(b"<SourceSpectrum>", data)
    if cut:
        mended.append(f"{cut} elements SourceSpectrum that begin without '<'")
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate()
    parser.buffer_text = True
    depth = 0

    def refuse(*_: object) -> None:
        raise DataError(f"{path}: expected XML without a document type, found one; entities are not read")

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            raise DataError(f"{path}: expected elements up to {_DEEPEST} within each other, found more")
        builder.start(name.rpartition(":")[2], attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name.rpartition(":")[2])

    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(data, True)
        return builder.close(), "; ".join(mended)
    except (expat.ExpatError, LookupError, ValueError, AssertionError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{path}: expected {EXPECTED}, found XML that is damaged: {error}") from None
