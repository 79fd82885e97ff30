"""`snapo new`: copies the commented example of a domain into a folder."""

from importlib.resources import files
from pathlib import Path

from snapo.case.error import CaseError


def write_case(package: str, folder: str | Path, size: str | None = None) -> list[Path]:
    """Writes the template of the domain `package` into `folder`; returns the files written.

    A domain with examples of several sizes keeps each in a folder of its own, `template_SIZE`.

    **Raises:** `CaseError` where the folder cannot be used, or a file of the same name is there
    already; then nothing is written.
    """
    folder = Path(folder)
    source = files(package) / (f"template_{size}" if size else "template")
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
