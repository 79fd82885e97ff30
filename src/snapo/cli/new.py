"""`snapo new`: copies the commented example of a domain into a folder."""

from importlib.resources import files
from pathlib import Path

from ..case import CaseError


def write_case(package: str, folder: str | Path) -> list[Path]:
    """Writes the template of the domain `package` into `folder`; returns the files written.

    **Raises:** `CaseError` where the folder cannot be used, or a file of the same name is there
    already; then nothing is written.
    """
    folder = Path(folder)
    source = files(package) / "template"
    texts = {each.name: each.read_bytes() for each in source.iterdir() if each.is_file()}
    for name in texts:
        if (folder / name).exists():
            raise CaseError(str(folder / name), "", None, "this file exists; nothing was written")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_bytes(text)
    except OSError as error:
        what = f"the folder cannot be written ({error.strerror})"
        raise CaseError(str(folder), "", None, what) from None
    return sorted(folder / name for name in texts)
