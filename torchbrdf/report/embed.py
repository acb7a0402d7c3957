"""Templates of pages, and pictures as text inside them."""

import base64
import io
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from PIL import Image
from torch import Tensor

from torchbrdf.images import to_bytes


def template(name: str) -> Template:
    """The Jinja template of a page, from this folder."""
    loader = PackageLoader("torchbrdf.report", ".")
    pages = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    pages.filters["counted"] = counted
    return pages.get_template(name)


def counted(count: int, thing: str) -> str:
    """How many there are of a thing: "1 lobe", "2 lobes"."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def embed_png(path: Path) -> str:
    """A PNG file as a data URI."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()


def embed_display(display: Tensor, kind: str, **options: object) -> str:
    """Display values `(H, W, 3)` as a data URI of "jpeg" or "webp"; options are Pillow's."""
    data = io.BytesIO()
    Image.fromarray(to_bytes(display)).save(data, format=kind, **options)
    return f"data:image/{kind};base64," + base64.b64encode(data.getvalue()).decode()


def embed_webp(path: Path) -> str:
    """A picture as a data URI of WebP, so that a page with hundreds of them has a few megabytes."""
    data = io.BytesIO()
    with Image.open(path) as image:
        image.save(data, format="WEBP", quality=90, method=2)  # half the time of Pillow's own, 4, for 5 % more bytes
    return "data:image/webp;base64," + base64.b64encode(data.getvalue()).decode()
