"""A page as a PDF, printed by a browser of this machine."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

VARIABLE = "SNAPO_BROWSER"  # of the environment: a browser to take before all others
BROWSERS = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome",
    "microsoft-edge", "msedge", "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
)  # fmt: skip
SECONDS = 120  # after which a browser is given up


def browser() -> str | None:
    """The path of a browser that can print without a window, None where there is none."""
    by_name = os.environ.get(VARIABLE)
    names = (by_name,) if by_name else BROWSERS
    return next((path for name in names if (path := shutil.which(name))), None)


def print_page(page: Path, file: Path, browser: str) -> None:
    """Prints an HTML `page` to the PDF `file`; styles are those of the page for print.

    The page is a file and names nothing outside of itself, so nothing is sent.

    **Raises:** `OSError` where the browser fails or takes too long.
    """
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "page.pdf"
        command = [
            browser, "--headless", "--disable-gpu", "--no-first-run", "--disable-sync",
            "--disable-background-networking", "--disable-component-update",
            f"--user-data-dir={folder}/profile", "--no-pdf-header-footer",
            "--print-to-pdf-no-header", f"--print-to-pdf={made}", page.resolve().as_uri(),
        ]  # fmt: skip
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.insert(1, "--no-sandbox")  # which a browser refuses to have as root
        try:
            done = subprocess.run(command, capture_output=True, timeout=SECONDS, check=False)
        except subprocess.TimeoutExpired:
            raise OSError(f"{browser} has not printed within {SECONDS} s") from None
        if not made.exists() or not made.read_bytes().startswith(b"%PDF"):
            metadata = done.stderr.decode(errors="replace").strip().splitlines()
            raise OSError(
                f"{browser} ended with {done.returncode}: {metadata[-1] if metadata else ''}"
            )
        file.write_bytes(made.read_bytes())
