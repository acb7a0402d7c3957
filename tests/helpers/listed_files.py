"""Files of scattered samples as instruments write them, made up; the BRDF that they hold is known."""

import json

import numpy as np

BANDS = (465.0, 525.0, 630.0)
COLOR = np.array([0.2, 0.5, 0.8])


def known(theta_i, theta_o, phi):
    """A reciprocal BRDF of a light, a viewer and the azimuth between, radians; lobe and diffuse, `(N,)`."""
    wi = np.stack([np.sin(theta_i), 0 * theta_i, np.cos(theta_i)], -1)
    wo = np.stack([np.sin(theta_o) * np.cos(phi), np.sin(theta_o) * np.sin(phi), np.cos(theta_o)], -1)
    h = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
    return 0.1 + 2 * np.exp(-((np.arccos(np.clip(h[..., 2], -1, 1)) / 0.2) ** 2))


def angles(step=10, lights=(0, 20, 40, 60)):
    """Rows of theta_i, phi_i, theta_s, phi_s in degrees, as a goniophotometer takes them."""
    rows = [
        (light, 180, polar, azimuth)
        for light in lights
        for polar in range(0, 90, step)
        for azimuth in (range(0, 360, 20) if polar else [0])
    ]
    return np.array(rows, float)


def values(rows):
    """Of rows of angles in degrees, in three bands."""
    light, turn, polar, azimuth = np.radians(rows).T
    return known(light, polar, azimuth - turn)[:, None] * COLOR


def astm(rows=None, *, names="theta_i,phi_i,theta_s,phi_s", bands="465nm,525nm,630nm", points=None, unit=np.radians):
    """Text of an ASTM E1392 file."""
    rows = angles() if rows is None else rows
    table = np.concatenate([unit(rows), values(rows)], 1)
    head = [
        "LAB_NAME made up",
        "",
        "SAMPLE_NAME paint",
        f"NUM_POINTS {points or len(rows)}",
        f"VARS {names},{bands}",
        "",
    ]
    return "\n".join([*head, *(",".join(f"{one:.12g}" for one in row) for row in table)]) + "\n"


def cornell(rows=None):
    """Text of a file of Cornell's, of four bands that reflect alike."""
    rows = angles() if rows is None else rows
    grey = values(rows)[:, :1] / COLOR[0]
    table = np.concatenate([np.radians(rows), grey.repeat(4, 1)], 1)
    head = [
        "# made up",
        "",
        "# num wls",
        "4",
        "",
        "# wls",
        "400 500",
        "600 700",
        "",
        "# theta i, phi i, theta s, phi_s",
        "",
    ]
    return "\n".join([*head, *(" ".join(f"{one:.9f}" for one in row) for row in table)]) + "\n"


def columns(rows=None, mark=","):
    """Text of named columns."""
    rows = angles() if rows is None else rows
    table = np.concatenate([rows[:, [2, 0]], rows[:, 3:] - rows[:, 1:2], values(rows)], 1)
    lines = [mark.join(f"{one:.9g}" for one in row) for row in table]
    return "\n".join(["# made up", mark.join(["theta_o", "theta_i", "phi", "r", "g", "b"]), *lines]) + "\n"


def bird(rows=None):
    """Text of a BiRD file: two bands that reflect alike, light of each twice."""
    rows = angles() if rows is None else rows
    every = rows.repeat(4, 0)
    names = ("theta_i", "phi_i", "theta_r", "phi_r")
    data = {name: {"unit": "\u00b0", "values": column.tolist()} for name, column in zip(names, every.T, strict=True)}
    data["wavelength_i"] = {"unit": "nm", "values": [500, 500, 600, 600] * len(rows)}
    level = values(every)[:, 0] * np.tile([0.5, 1.5, 0.5, 1.5], len(rows))
    data["BRDF"] = {"unit": "sr^-1", "values": level.tolist()}
    return json.dumps({"metadata": {"schema": "https://example.org/brdf_json_schema_v1.0.json"}, "data": data})


def fred(rows=None):
    """Text of a table of FRED's: a light, and at its azimuth the mirror direction."""
    rows = angles() if rows is None else rows
    lines = ["type bsdf_data", "format angles=deg bsdf=value scale=2"]
    last = None
    for (light, _, polar, azimuth), value in zip(rows, values(rows)[:, 0], strict=True):
        if light != last:
            lines.append(f"{light:g}\t0")
            last = light
        lines.append(f"{polar:g}\t{azimuth:g}\t{value / 2:.9f}")
    return "\n".join(lines) + "\n"


def ssdd(
    system="half_difference",
    color="rgb",
    polar=tuple(range(0, 90, 10)),
    azimuths=tuple(range(0, 181, 20)),
    *,
    binary=False,
):
    """An SSDD file, text or with binary values: a grid whose first axis runs fastest."""
    fine = tuple(90 * (np.arange(13) / 12) ** 2)
    axes = {
        "half_difference": (fine, polar, tuple(range(0, 91, 15))),
        "spherical": (polar, polar, azimuths),
        "specular": (polar, fine, azimuths),
    }[system]
    last, third, first = (np.radians(one) for one in np.meshgrid(*axes[::-1], indexing="ij"))
    level = _known_in(system, first, third, last).reshape(-1, 1)
    channels = {"monochrome": [1], "rgb": COLOR, "spectrum": COLOR, "xyz": [0.95046, 1.0, 1.08906]}[color]
    values = level * np.array(channels)
    lines = ["VERSION 0.2", "SOFTWARE made-up", "", "# A comment", "DATA_TYPE brdf", f"COLOR_MODEL {color}"]
    lines += ["WAVELENGTH_LIST " + " ".join(map(str, BANDS))] * (color == "spectrum")
    lines += [f"PARAM_TYPE {system}_coordinate_system", "REDUCTION_TYPE bilateral_symmetry"]
    lines += [
        f"PARAM{k}_LIST {' '.join(f'{one:.9g}' for one in axis)}" for k, axis in zip((0, 2, 3), axes, strict=True)
    ]
    lines += ["NAME paint", f"DATA {'binary' if binary else 'ascii'}", ""]
    head = "\n".join(lines)
    if binary:
        return head.encode() + values.astype("<f4").tobytes()
    return head + "\n".join(" ".join(f"{one:.9g}" for one in row) for row in values) + "\n"


def _known_in(system, first, third, last):
    """The known BRDF by the angles of a system; 7 below the horizon, where nobody looks."""
    if system == "spherical":
        return known(first, third, last)
    if system == "specular":
        x, y, z = np.sin(third) * np.cos(last), np.sin(third) * np.sin(last), np.cos(third)
        wo = np.stack([np.cos(first) * x - np.sin(first) * z, y, np.sin(first) * x + np.cos(first) * z], -1)
        found = known(first, np.arccos(np.clip(wo[..., 2], -1, 1)), np.arctan2(wo[..., 1], wo[..., 0]))
        return np.where(wo[..., 2] > 0, found, 7)
    lobe = 0.1 + 2 * np.exp(-((first / 0.2) ** 2))
    over = np.cos(first) * np.cos(third) - np.abs(np.sin(first) * np.sin(third) * np.cos(last)) > 0
    return np.where(over, lobe, 7)


def zemax(
    lights=(10, 40), azimuths=tuple(range(0, 181, 20)), radials=tuple(range(0, 91, 10)), *, symmetry="PlaneSymmetrical"
):
    """Text of an interchange file; directions below the horizon are 0."""
    lines = [
        "# made up",
        "Source\tMeasured",
        f"Symmetry\t{symmetry}",
        "SpectralContent\tMonochrome",
        "ScatterType\tBRDF",
    ]
    for name, axis in (
        ("SampleRotation", (0,)),
        ("AngleOfIncidence", lights),
        ("ScatterAzimuth", azimuths),
        ("ScatterRadial", radials),
    ):
        lines += [f"{name}\t{len(axis)}", "\t".join(map(str, axis))]
    lines += ["", "Monochrome", "DataBegin"]
    for light in np.radians(lights):
        lines.append("TIS\t0.1")
        mirror = np.array([-np.sin(light), 0, np.cos(light)])
        toward, across = np.array([np.cos(light), 0, np.sin(light)]), np.array([0.0, 1, 0])
        for azimuth in np.radians(azimuths):
            row = []
            for radial in np.radians(radials):
                wo = mirror * np.cos(radial) + (toward * np.cos(azimuth) + across * np.sin(azimuth)) * np.sin(radial)
                polar, turn = np.arccos(np.clip(wo[2], -1, 1)), np.arctan2(wo[1], wo[0])
                row.append(known(np.array(light), polar, turn) if wo[2] > 1e-3 else 0.0)
            lines.append("\t".join(f"{float(one):.6e}" for one in row))
    return "\n".join([*lines, "DataEnd"]) + "\n"


def unit_vectors(rows):
    """The viewer and the light of rows of angles in radians, `(N, 6)`."""
    light, viewer = (
        np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
        for theta, phi in (rows[:, :2].T, rows[:, 2:].T)
    )
    return np.concatenate([viewer, light], -1)


def alta(rows=None, *, name="SPHERICAL_TL_PL_TV_PV", place=None, vs=0, out="RGB_COLOR", order=None):
    """ALTA's text, or with the order "little" or "big" of bytes its binary.

    `place` makes the coordinates that are called `name` of rows in radians; by default they are the rows.
    """
    rows = angles() if rows is None else rows
    given = np.radians(rows) if place is None else place(np.radians(rows))
    found = values(rows) if out.endswith("COLOR") else values(rows)[:, :1]
    bounds = [found + side for side in (-1, 1)][:vs]
    table = np.concatenate([given, found, *bounds], 1)
    head = [f"#DIM {given.shape[1]} {found.shape[1]}", f"#PARAM_IN  {name}", f"#PARAM_OUT {out}", f"#VS {vs}"]
    if order is None:
        return "\n".join(["#SAMPLE made up", *head, *("\t".join(f"{one:.15g}" for one in row) for row in table)]) + "\n"
    head += ["#FORMAT binary", "#VERSION 0", "#PRECISION ieee754-double", f"#SAMPLE_COUNT {len(rows)}"]
    head += [f"#ENDIAN {order}", "#BEGIN_STREAM", ""]
    return "\n".join(head).encode() + table.astype("<f8" if order == "little" else ">f8").tobytes() + b"\n#END_STREAM\n"


def openmaterial(rows=None, bands=BANDS, azimuth=0):
    """Text of an OpenMATERIAL 3D table; `azimuth` is added to that of the viewer."""
    rows = angles() if rows is None else rows
    table = [
        [band * 1e-9, np.radians(light), np.radians(polar), np.radians((turn - start + azimuth) % 360), value]
        for k, band in enumerate(bands)
        for (light, start, polar, turn), value in zip(rows, values(rows)[:, k], strict=True)
    ]
    meta = {"name": "made up", "openMaterial3dVersion": "1.0.0", "sources": "measurement"}
    return json.dumps(
        {"metadata": meta, "brdf": {"wavelengths": [1e-9 * band for band in bands], "lookupTable": table}}
    )
