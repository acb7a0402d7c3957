"""The XML files of LBNL's WINDOW and of Radiance: which scattering data they have, of which side and wavelengths."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import ClassVar, NamedTuple
from xml.parsers import expat

import numpy as np

from torchbrdf.errors import DataError, shown
from torchbrdf.measured.gridded import GriddedFormat
from torchbrdf.measured.listed import QUANTITIES
from torchbrdf.measured.rows import head_lines
from torchbrdf.reading import check_unpacked, read_bytes

EXPECTED = "a BSDF XML file of WINDOW or Radiance"
BANDS = ("visible", "solar", "nir")
# What stands beside the visible band where there are tristimulus values; that band is Y.
TRISTIMULUS = ("cie-x", "visible", "cie-z")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf(?:inity)?)", re.IGNORECASE)
# Of a number while it is read: a text and a number of Python's.
_BYTES_A_NUMBER = 100
# Elements within each other; files have nine.
_DEEPEST = 64


class Block(NamedTuple):
    """Scattering data: from which side light comes and whether it goes through, in which band."""

    direction: str
    band: str
    element: ET.Element

    def said(self, name: str) -> str:
        """The text of an element within; "" where there is none."""
        return text_of(self.element, name)


class Document(NamedTuple):
    """What a file says: its definition of data, its blocks, and what it calls the material."""

    structure: str
    definition: ET.Element
    blocks: list[Block]
    material: str


class Chosen(NamedTuple):
    """The blocks that are read, by band, and how they were chosen, by name."""

    side: str
    blocks: dict[str, Block]
    facts: dict[str, object]


class WindowFormat(GriddedFormat):
    """Base of the two kinds of these files. Only a reflection is read, from the front or from the back.

    The frame of the front is the file's, seen from there, with its y the other way round, so that it is right-handed;
    Radiance calls that side the back.

    Attributes:
        has_colors: Whether tristimulus values are read, and not luminance alone.
    """

    has_colors: ClassVar[bool] = False
    settings: ClassVar = {"side": ("auto", "front", "back"), "band": ("auto", *BANDS), "quantity": QUANTITIES}

    def chosen(self, path: Path, document: Document) -> Chosen:
        """The blocks of one side, and how that was decided."""
        found: dict[tuple[str, str], Block] = {}
        for block in document.blocks:
            if (block.direction, block.band) in found:
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
        band = self._band(path, side, list(own))
        rest = [name for name in own if name != band]
        facts: dict[str, object] = {"material": shown(document.material)} if document.material else {}
        more = "" if told == side else "; --read side=front, side=back"
        facts["side"] = f"{side}; the file has {shown(words, 120)}{more}"
        if self.has_colors and set(TRISTIMULUS) <= set(own) and band == "visible":
            own, rest = {name: own[name] for name in TRISTIMULUS}, [name for name in rest if name not in TRISTIMULUS]
        else:
            own = {band: own[band]}
        facts["band"] = ", ".join(own) + (f"; passed over: {shown(', '.join(rest))}" if rest else "")
        kind = own[band].said("ScatteringDataType")
        if kind.upper() not in ("", "BRDF"):
            facts["kind"] = f"the block says {shown(kind)}, its direction reflection; the direction was believed"
        return Chosen(side, own, facts)

    def _band(self, path: Path, side: str, there: list[str]) -> str:
        told = self.setting("band", "auto")
        known = [band for band in BANDS if band in there]
        if told == "auto" and known:
            return known[0]
        if told in known:
            return told
        wanted = told if told != "auto" else f"one of {', '.join(BANDS)}"
        raise DataError(f"{path}: reflection {side}: expected the band {wanted}, found {shown(', '.join(there))}")


def is_window(path: Path, head: bytes) -> bool:
    """Whether a file is one of these, by its root."""
    start = head_lines(path, head)
    return bool(start) and start[0].startswith("<") and any("<WindowElement" in line for line in start)


def is_tree(path: Path) -> bool:
    """Whether one of these files holds a tensor tree."""
    return b"TensorTree" in read_bytes(path, EXPECTED)


def read_window(path: Path) -> Document:
    """What a file says.

    Raises:
        DataError: It is no such file. Entities, which can blow up, are none of theirs: no document type is read.
    """
    root = _parsed(path)
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
        Block(_plain(text_of(block, "WavelengthDataDirection")), _plain(text_of(data, "Wavelength")), block)
        for data in layer.findall("WavelengthData")
        for block in data.findall("WavelengthDataBlock")
    ]
    return Document(text_of(definition, "IncidentDataStructure"), definition, blocks, text_of(layer, "Material/Name"))


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


def _parsed(path: Path) -> ET.Element:
    """The elements of a file, without prefixes of namespaces."""
    data = read_bytes(path, EXPECTED)
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
        return builder.close()
    except (expat.ExpatError, LookupError, ValueError, AssertionError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{path}: expected {EXPECTED}, found XML that is damaged: {error}") from None
