"""Files of tables over directions as tools of lighting and rendering write them, made up; the BRDF in them is known."""

import gzip
import struct

import numpy as np
import torch

from helpers.listed_files import known
from torchbrdf.measured import load
from torchbrdf.pairs import Pairs

BASES = {
    "LBNL/Klems Full": ((5, 15, 25, 35, 45, 55, 65, 75, 90), (1, 8, 16, 20, 24, 24, 24, 16, 12)),
    "LBNL/Klems Half": ((6.5, 19.5, 32.5, 46.5, 61.5, 76.5, 90), (1, 8, 12, 16, 20, 12, 4)),
    "LBNL/Klems Quarter": ((9, 27, 46, 66, 90), (1, 8, 12, 12, 8)),
    "two rings": ((30, 90), (4, 6)),
}


def directions(theta, phi):
    """Unit vectors, `(N, 3)`, of radians."""
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1)


def grained(wi, wo):
    """A reciprocal BRDF with a grain at 30 degrees from +x, `(N,)`."""
    h = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
    turn = np.radians(30)
    along, across = (
        h[..., 0] * np.cos(turn) + h[..., 1] * np.sin(turn),
        h[..., 1] * np.cos(turn) - h[..., 0] * np.sin(turn),
    )
    return 0.1 + 2 * np.exp(-((along / 0.5) ** 2) - (across / 0.15) ** 2)


def isotropic(wi, wo):
    """The known BRDF of directions, `(N,)`."""
    turn = np.arctan2(wi[..., 0] * wo[..., 1] - wi[..., 1] * wo[..., 0], (wi[..., :2] * wo[..., :2]).sum(-1))
    return known(*(np.arctan2(np.hypot(one[..., 0], one[..., 1]), one[..., 2]) for one in (wi, wo)), turn)


def mbsdf(size=12, turns=18, *, rgb=False, name=b"MBSDF_DATA=", mirror=180, more=b""):
    """Bytes of a measured BSDF of MDL's."""
    theta = (np.arange(size) + 0.5) / size * np.pi / 2
    phi = (np.arange(turns) + 0.5) / turns * np.pi
    light, viewer, turn = np.meshgrid(theta, theta, phi, indexing="ij")
    value = known(light, viewer, turn if mirror == 180 else np.pi - turn)
    value = value[..., None] * [1, 2, 3] if rgb else value
    head = b'NVIDIA ARC MBSDF V1\ndescription="made up"\n' + name + b"\n"
    return head + struct.pack("<3I", int(rgb), size, turns) + value.astype("<f4").tobytes() + more


def patches(basis):
    """Angles from the normal and azimuths of the patches of a basis, radians, `(P, 2)`."""
    bounds, counts = BASES[basis]
    rows = []
    for low, high, count in zip((0, *bounds), bounds, counts, strict=False):
        middle = 0 if count == 1 else (low + high) / 2
        rows += [(np.radians(middle), 2 * np.pi * k / count) for k in range(count)]
    return np.array(rows)


def window_xml(blocks, structure="Columns", definition=""):
    """Text of a file of WINDOW's: blocks of direction, band, bases' elements and data."""
    parts = [
        f"""<WavelengthData><LayerNumber>System</LayerNumber><Wavelength unit="Integral">{band}</Wavelength>
<WavelengthDataBlock><WavelengthDataDirection>{direction}</WavelengthDataDirection>{bases}
<ScatteringDataType>BTDF</ScatteringDataType>
<ScatteringData>
{data}</ScatteringData></WavelengthDataBlock></WavelengthData>"""
        for direction, band, bases, data in blocks
    ]
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            '<WindowElement xmlns="http://windows.lbl.gov">',
            "<Optical><Layer><Material><Name>made up</Name></Material>",
            f"<DataDefinition><IncidentDataStructure>{structure}</IncidentDataStructure>{definition}</DataDefinition>",
            *parts,
            "</Layer></Optical></WindowElement>\n",
        ]
    )


def definition(basis):
    """The element that defines a basis."""
    bounds, counts = BASES[basis]
    rings = "".join(
        f"<AngleBasisBlock><Theta>{(low + high) / 2}</Theta><nPhis>{count}</nPhis><ThetaBounds><LowerTheta>{low}"
        f"</LowerTheta><UpperTheta>{high}</UpperTheta></ThetaBounds></AngleBasisBlock>\n"
        for low, high, count in zip((0, *bounds), bounds, counts, strict=False)
    )
    return f"<AngleBasis><AngleBasisName>{basis}</AngleBasisName>{rings}</AngleBasis>"


def klems_block(basis="LBNL/Klems Quarter", direction="Reflection Back", band="Visible", *, scale=1.0, by_row=False):
    """A block of values of the grained BRDF in the file's own frame."""
    own = patches(basis)
    light, viewer = directions(own[:, 0], own[:, 1] + np.pi), directions(own[:, 0], own[:, 1])
    values = scale * grained(light[None], viewer[:, None])
    rows = values.T if by_row else values
    data = "\n".join(" ".join(f"{one:.9g}," for one in row) for row in rows)
    bases = f"<ColumnAngleBasis>{basis}</ColumnAngleBasis><RowAngleBasis>{basis}</RowAngleBasis>"
    return direction, band, bases, data


def klems(basis="LBNL/Klems Quarter", **options):
    """Text of a file with one block."""
    structure = "Rows" if options.get("by_row") else "Columns"
    own = definition(basis) if basis == "two rings" else ""
    return window_xml([klems_block(basis, **options)], structure, own)


def disk(x, y):
    """Places in the unit disk of places in the unit square, by the four triangles of Shirley and Chiu."""
    a, b = 2 * x - 1, 2 * y - 1
    radius = np.select([(a > -b) & (a > b), (a > -b), (a < b)], [a, b, -a], -b)
    safe = np.where(radius == 0, 1, radius)
    turn = np.select([(a > -b) & (a > b), (a > -b), (a < b)], [b / safe, 2 - a / safe, 4 - b / safe], 6 + a / safe)
    return radius * np.cos(np.pi / 4 * turn), radius * np.sin(np.pi / 4 * turn)


def tree_directions(places):
    """Light and viewer of places in the unit cube, `(N, 3)` each, in the file's frame."""
    x, y = disk(places[:, -2], places[:, -1])
    wo = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], -1)
    if places.shape[1] == 4:
        x, y = disk(places[:, 0], places[:, 1])
    else:
        x, y = np.clip(1 - 2 * places[:, 0], -1, 1), 0 * places[:, 0]
    return np.stack([-x, -y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], -1), wo


def tree(rank, depth=2, cells=2, corner=None, width=1.0):
    """Text of a tensor tree of known values: levels of nodes, blocks of cells below; the lowest corner is finer."""
    corner = np.zeros(rank) if corner is None else corner
    if depth == 0:
        index = np.stack(np.unravel_index(np.arange(cells**rank), (cells,) * rank), -1)
        wi, wo = tree_directions(corner + (index + 0.5) * width / cells)
        values = (grained if rank == 4 else isotropic)(wi, wo)
        return "{ " + ", ".join(f"{one:.9g}" for one in values) + " }\n"
    halves = [np.array([n >> axis & 1 for axis in range(rank)]) for n in range(1 << rank)]
    inner = [
        tree(rank, depth - 1, cells * 2 if depth == 1 and not n else cells, corner + half * width / 2, width / 2)
        for n, half in enumerate(halves)
    ]
    return "{\n" + "".join(inner) + "}\n"


def tensor_tree(rank=3, direction="Reflection Back", data=None, **options):
    """Text of a file with one tree."""
    block = direction, "Visible", "<AngleBasis>LBNL/Shirley-Chiu</AngleBasis>", data or tree(rank, **options)
    return window_xml([block], f"TensorTree{rank}")


def fourier(terms=None, cosines=12, channels=1, *, flags=1, bases=1, packed=False, reflects=True, says=b""):
    """Bytes of pbrt's Fourier BSDF: `terms(cos_i, cos_o)` gives those of f |cos_i|; by default a Lambertian of 0.6."""
    terms = terms or (lambda cos_i, cos_o: [0.6 / np.pi * cos_i])
    half = np.linspace(0, 1, cosines) ** 1.5
    mu = np.concatenate([-half[::-1], half]).astype("<f4")
    lists, numbers = [], []
    for cos_o in mu:
        for cos_i in mu:
            above = reflects and np.signbit(cos_i) and not np.signbit(cos_o)
            own = np.array(terms(-float(cos_i), float(cos_o))) if above else np.empty(0)
            lists.append((len(numbers), own.shape[-1] if own.size else 0))
            numbers += own.reshape(-1).tolist()
    longest = max(length for _, length in lists)
    head = struct.pack(
        "<9if4i", flags, len(mu), len(numbers), longest, channels, bases, len(says), 0, 0, 1.5, 0, 0, 0, 0
    )
    parts = [mu, np.zeros(len(mu) ** 2, "<f4"), np.array(lists, "<i4"), np.array(numbers, "<f4")]
    data = b"SCATFUN\x01" + head + b"".join(part.tobytes() for part in parts) + says
    return gzip.compress(data, mtime=0) if packed else data


THETA, PHI = np.arange(0, 91, 10.0), np.arange(0, 361, 20.0)


def speos_table(light, f=isotropic, *, kind=0, theta=THETA, phi=PHI):
    """Values over theta and phi of the viewer, degrees; at phi = 0 lies the mirror direction."""
    polar, turn = np.meshgrid(np.radians(theta), np.radians(phi), indexing="ij")
    wi = directions(np.radians(light) + 0 * polar, np.pi + 0 * polar)
    value = f(wi, directions(polar, turn))
    return value * np.cos(polar) if kind == 0 else value


def speos(
    lights=(5, 30, 60), turns=(0,), *, kind=0, parts=(1, 0), spectrum=((350, 50), (850, 50)), f=isotropic, version="v11"
):
    """Text of an anisotropic BSDF of Speos'."""
    lines = [f"OPTIS - Anisotropic BSDF surface file {version}", "0", "comment", "7", "made up", "1\t0\t0"]
    lines += ["\t".join(map(str, parts)), str(kind)]
    for _ in range(sum(parts)):
        lines += [str(len(turns)), "\t".join(map(str, turns))]
        lines += [str(len(lights)), "\t".join(map(str, lights))] * len(turns)
    for _ in range(sum(parts)):
        lines += ["5\t0", "its spectrum", str(len(spectrum)), *(f"{wave}\t{share}" for wave, share in spectrum)]
    for part in range(sum(parts)):
        for _ in turns:
            for light in lights:
                lines += _rows(speos_table(light, f, kind=kind), THETA + 90 * (part or not parts[0]))
    return "\n".join(lines) + "\n"


def _rows(table, theta=THETA):
    rows = ["\t".join(f"{one:.9g}" for one in (angle, *row)) + "\t" for angle, row in zip(theta, table, strict=True)]
    return [f"{len(theta)} {len(PHI)}", "\t" + "\t".join(f"{one:g}" for one in PHI) + "\t", *rows]


def lz4(data):
    """A block of LZ4 that is all literals."""
    size, more = len(data), b""
    if size >= 15:
        more = b"\xff" * ((size - 15) // 255) + bytes([(size - 15) % 255])
    return bytes([min(size, 15) << 4]) + more + data


def speos_binary(lights=(5, 30, 60), *, kind=0, parts=(1, 0), share=50.0, f=isotropic):
    """Bytes of an anisotropic BSDF of Speos'."""

    def packed(values):
        data = np.asarray(values, "<f8").tobytes()
        own = lz4(data)
        return struct.pack("<qii", len(data), len(data), len(own)) + own

    def counted(values):
        return struct.pack("<i", len(values)) + packed(values)

    data = b"OPTIS - Anisotropic BSDF surface file v9.0\n1" + struct.pack("<4i3d", 3, 1, 0, 0, 1, 0, 0)
    data += struct.pack("<3b2d2b", kind, *parts, 1, 1, 0, 0)
    data += counted([0.0]) + counted(lights)
    data += struct.pack("<2dii4d", 5, 0, 0, 2, 350, 850, share, share)
    for light in lights:
        data += struct.pack("<2i", len(THETA), len(PHI))
        data += packed(THETA) + packed(PHI) + packed(speos_table(light, f, kind=kind).reshape(-1))
    return data + bytes(40)


def speos_spectral(
    lights=(5, 30, 60), waves=(450, 550, 650), shares=(20, 50, 80), *, kind=1, parts=(1, 0), f=isotropic
):
    """Text of a `.brdf` of Speos'."""
    lines = ["OPTIS - brdf surface file v9.0", "0", "comment", "0", "", "\t".join(map(str, parts)), str(kind)]
    lines += [f"{len(lights)}\t{len(waves)}", "\t".join(map(str, lights)), "\t".join(map(str, waves))]
    for light in lights:
        for share in shares:
            lines += [str(share), *_rows(speos_table(light, f, kind=kind))]
    return "\n".join(lines) + "\n"


def lighttools(lights=(0, 20, 40, 60), *, side="Front", kind="BRDF", content="Monochrome", poi=None, waves=(550,)):
    """Text of a BSDF of LightTools': light from azimuth 90."""
    azimuth, radial = np.arange(0, 360, 20.0), np.arange(0, 90, 10.0)
    lines = ["# made up", "Symmetry Asymmetric", f"SpectralContent {content}"]
    for name, axis in (("ScatterAzimuth", azimuth), ("ScatterRadial", radial)):
        lines += [f"{name} {len(axis)}", " ".join(f"{one:g}" for one in axis)]
    lines.append("DataBegin")
    turn, polar = np.meshgrid(np.radians(azimuth), np.radians(radial), indexing="ij")
    for light in lights:
        for name in ("TrisX", "TrisY", "TrisZ") if content == "XYZ" else waves:
            lines += [f"AOI {light}", f"POI {poi or 90}", f"Side {side}"]
            lines.append(f"TristimulusValue {name}" if content == "XYZ" else f"Wavelength {name}")
            lines += [f"ScatterType {kind}", "TIS 0.5"]
            value = isotropic(directions(np.radians(light) + 0 * polar, np.pi / 2 + 0 * polar), directions(polar, turn))
            lines += [" ".join(f"{one:.9g}" for one in row) for row in value]
    return "\n".join([*lines, "DataEnd"]) + "\n"


def written(folder, data, name="made-up.dat"):
    """The path of a file that holds bytes or text."""
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def opened(folder, data, name="made-up.dat", **settings):
    """What is measured in a file that holds bytes or text."""
    return load(written(folder, data, name), dtype=torch.float64, settings=settings or None)


def at(measured, interpolation="linear", step=0):
    """Pairs above the horizon, and values at them: the samples, or others nearby, `(N, 3)`."""
    pairs = measured.pairs
    if step:
        source = torch.Generator().manual_seed(0)
        moved = [one + step * torch.randn(one.shape, generator=source, dtype=one.dtype) for one in (pairs.wi, pairs.wo)]
        pairs = Pairs.from_directions(*(torch.nn.functional.normalize(one, dim=-1) for one in moved))
    high = (torch.minimum(pairs.cos_i, pairs.cos_o)[0] > 0.1).nonzero()[:, 0]
    pairs = pairs.select(samples=high)
    return pairs, measured.at(pairs, interpolation)[0]


def expected(pairs, f=isotropic):
    """A known BRDF at pairs, `(N,)`."""
    return torch.from_numpy(f(pairs.wi[0].numpy(), pairs.wo[0].numpy()))
