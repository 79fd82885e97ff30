"""`[report]` of every kind of case: the user's texts and picture on the page of a run."""

import base64
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, ValidationInfo

from .table import CaseTable, doc, subtable

PNG = b"\x89PNG\r\n\x1a\n"
LARGEST_LOGO = 1_000_000  # bytes, which a page holds in full
TEXTS = ("title", "author", "note", "logo")  # keys that no number depends on
SHORT = "a text of at most 200 characters"
ALLOWED = "the name of a PNG or SVG file next to the case, of at most 1 MB"
# Elements that run, load or contain something else; an attribute that begins with "on" does too.
ACTIVE = (
    "script", "foreignobject", "iframe", "object", "embed", "audio", "video", "handler", "listener",
    "animate", "set", "animatetransform", "animatemotion", "a",
)  # fmt: skip
FORBIDDEN = ("javascript:", "@import", "expression(")


def _checked(name: str, info: ValidationInfo) -> str:
    table: Any = info.context
    try:
        logo(table.file.parent, name)
    except OSError as error:
        reason = f"the file cannot be read ({error.strerror})"
    except ValueError as error:
        reason = str(error)
    else:
        return name
    raise table.error("logo", name, f"{reason}; it must be {ALLOWED}")


ReportKey = Annotated[dict[str, Any], subtable("texts and logo of the page of a run", "report", {})]


class ReportTable(CaseTable):
    """`[report]`: title, author, note and logo of the page."""

    title: str | None = doc("heading of the page", None, SHORT, max_length=200)
    author: str | None = doc("author of the run, on the first page", None, SHORT, max_length=200)
    note: str | None = doc(
        "remark on the run",
        None,
        "a text of at most 2,000 characters, for the first page",
        max_length=2_000,
    )
    logo: Annotated[str, AfterValidator(_checked)] | None = doc(
        "picture at the head of the page", None, ALLOWED
    )


def logo(folder: Path, name: str) -> str:
    """A data URL that contains the whole picture in a file next to a case.

    **Raises:** `OSError`, and `ValueError` if the file is no pure picture or is too large.
    """
    if not name or Path(name).name != name or "\\" in name:
        raise ValueError("a name with a folder is not a file next to the case")
    file = folder / name
    if not file.is_file():
        raise ValueError("there is no such file")
    content = file.read_bytes()
    if len(content) > LARGEST_LOGO:
        raise ValueError(f"the file is too large: it has {len(content):,} bytes")
    if content.startswith(PNG):
        kind = "png"
    elif file.suffix.lower() == ".svg":
        _check_svg(content)
        kind = "svg+xml"
    else:
        raise ValueError("this is neither a PNG nor an SVG file")
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _check_svg(content: bytes) -> None:
    """**Raises:** `ValueError` if a drawing has scripts or would load another file."""
    import xml.etree.ElementTree as ElementTree  # late: few cases have a drawing

    before = content.partition(b"<svg")[0]
    if b"<!ENTITY" in content or (b"<!DOCTYPE" in before and b"[" in before):
        raise ValueError("an SVG file with entities is not accepted")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise ValueError(f"this is not an SVG file ({error})") from None
    if _local(root.tag) != "svg":
        raise ValueError("this is not an SVG file")
    for element in root.iter():
        tag = _local(element.tag)
        if tag in ACTIVE or "xhtml" in str(element.tag):
            raise ValueError(f"an SVG file with <{tag}> is not accepted")
        texts = [element.text or ""] if tag == "style" else []
        for key, value in element.attrib.items():
            if _local(key).startswith("on"):
                raise ValueError(f"an SVG file with {_local(key)}= is not accepted")
            if _local(key) in ("href", "src") and not value.startswith(("#", "data:image/")):
                raise ValueError(f"an SVG file that loads {value[:60]} is not accepted")
            texts += [value] if _local(key) not in ("href", "src") else []
        joined = " ".join(texts).lower()
        if "url(" in joined.replace("url(#", "") or any(word in joined for word in FORBIDDEN):
            raise ValueError("an SVG file that loads other files is not accepted")


def _local(tag: Any) -> str:
    """The name without its namespace, in small letters; "" for a comment."""
    return tag.rpartition("}")[2].lower() if isinstance(tag, str) else ""
