"""Names of materials and stimuli: what may be one, and how it is written into paths."""

import hashlib
import re
import unicodedata
from collections.abc import Sequence

from torchbrdf.errors import DataError, shown

# A file system takes 255 bytes; some are left for what comes before and behind.
LONGEST_NAME = 200


def check_name(name: object, where: str) -> str:
    """A name that is one: text of one printable line, that no file system takes for a path.

    Args:
        name: What a file or a caller gives.
        where: What to call it in an error.

    Returns:
        The name.

    Raises:
        DataError: It is no text, empty, too long, begins or ends with a space, has `/` or a backslash, is `.` or
            `..`, or has characters that are not to be seen.

    Example:
        >>> from torchbrdf.names import check_name
        >>> check_name("gold-metallic-paint2", "fits.json: fit 0: material")
        'gold-metallic-paint2'
    """
    if isinstance(name, str) and name == clean_name(name):
        return name
    raise DataError(f"{where}: expected a name (one line, no path, at most {LONGEST_NAME} bytes), found {shown(name)}")


def clean_name(text: str, longest: int = LONGEST_NAME) -> str:
    r"""The name that comes closest to a text, such as the stem of a file.

    Args:
        text: Anything, also what the system gives for a path that is no UTF-8.
        longest: How many bytes the name may have, where something is to come behind it.

    Returns:
        A name that `check_name` accepts.

    Example:
        >>> from torchbrdf.names import clean_name
        >>> clean_name("blue/acrylic\n"), clean_name("..")
        ('blue_acrylic', '_')
    """
    if text.isascii() and text.isprintable():
        name = text.replace("/", "_").replace("\\", "_").strip()
    else:
        name = "".join(c if _is_seen(c) and c not in "/\\" else " " if c.isspace() else "_" for c in text).strip()
    if set(name) <= {"."}:
        name = "_"
    while len(name.encode()) > longest:
        name = name[:-1].rstrip()
    return name


def file_stem(name: str) -> str:
    """A name as the stem of a file, on every system: different names have different stems.

    Args:
        name: Of a material or stimulus.

    Returns:
        The name itself where all systems allow it, else what is left of it and a few digits of its hash.

    Example:
        >>> from torchbrdf.names import file_stem
        >>> file_stem("nickel"), file_stem("a:b")
        ('nickel', 'a_b-6783a31e')
    """
    plain = re.sub(r'[<>:"/\\|?*\x00-\x1f]', "_", clean_name(name)).rstrip(". ")
    # A device is one with any suffix, too.
    plain = re.sub(r"(?i)^(con|prn|aux|nul|com\d|lpt\d)( *)\.", r"\1\2_", plain)
    if plain == name and not re.fullmatch(r"(?i)con|prn|aux|nul|com\d|lpt\d", plain):
        return name
    digits = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    # Short enough for a name, by which the stem of a stem is itself.
    return f"{clean_name(plain, LONGEST_NAME - 1 - len(digits))}-{digits}" if plain else f"_-{digits}"


def distinct_stems(names: Sequence[str], reserved: Sequence[str] = ()) -> list[str]:
    """Names of files in one folder, without suffix, no two the same, also where case does not count.

    They are `file_stem`s; one that is taken gets a number behind, and none is hidden by a dot in front.

    Args:
        names: Of materials.
        reserved: Stems that none may have.

    Example:
        >>> from torchbrdf.names import distinct_stems
        >>> distinct_stems(["Nickel", "nickel"])
        ['Nickel', 'nickel-2']
    """
    taken = {same_file(name) for name in reserved}
    made = []
    for name in names:
        plain = file_stem(name).lstrip(".") or "_"
        number, stem = 1, plain
        while same_file(stem) in taken:
            number += 1
            end = f"-{number}"
            stem = clean_name(plain, LONGEST_NAME - len(end)) + end
        taken.add(same_file(stem))
        made.append(stem)
    return made


def same_file(stem: str) -> str:
    """What is the same for names that are one file on some system: those that differ in case, or in how accents are."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", stem).casefold())


def is_one_line(text: str) -> bool:
    r"""Whether a text is one printable line; no-break and other spaces are printed, too.

    Example:
        >>> from torchbrdf.names import is_one_line
        >>> is_one_line("a / b\u00a0c"), is_one_line("a\nb")
        (True, False)
    """
    return text.isprintable() or all(map(_is_seen, text))


def _is_seen(character: str) -> bool:
    """Whether it is printed; spaces of all widths are, ends of lines are not."""
    return character.isprintable() or unicodedata.category(character) == "Zs"
