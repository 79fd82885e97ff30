"""Results as data frames of the library that the caller uses."""

from collections.abc import Mapping
from typing import Any

BACKENDS = ("pandas", "polars", "pyarrow")


def frame(columns: Mapping[str, Any], backend: str = "pandas") -> Any:
    """A data frame with these columns; a table of Arrow for "pyarrow".

    **Raises:** `ValueError` for another backend, `ModuleNotFoundError` where it is not installed.
    """
    try:
        match backend:
            case "pandas":
                import pandas

                return pandas.DataFrame(dict(columns))
            case "polars":
                import polars

                return polars.DataFrame(dict(columns))
            case "pyarrow":
                import pyarrow

                return pyarrow.table(dict(columns))
    except ModuleNotFoundError:
        message = f"frame: {backend} is not installed: pip install {backend}"
        raise ModuleNotFoundError(message) from None
    raise ValueError(f"frame: {backend!r}; allowed is one of {', '.join(BACKENDS)}.")
