"""Parquet tables of a book, a file for each contract or for several, and queries on them."""

from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.problem.carry.arrays import replacing

from .folder import TABLES

TableRows = dict[str, list[Any]]  # {column: values}
NUMBERS = (
    "value", "standard_error", "change", "change_error", "explained", "unexplained", "cpu_seconds",
    "peak_mb", "held", "held_error", "share", "deviation", "p05", "p95", "nominal", "within",
)  # fmt: skip


class TableWriter:
    """Writes the rows of contracts, with `together` contracts in each file.

    A context manager; each file is written completely or not at all.
    """

    def __init__(self, path: Path, together: int):
        self.path, self.together = path, together
        self.waiting: list[dict[str, TableRows]] = []
        self.names: list[str] = []

    def __enter__(self) -> "TableWriter":
        for name in TABLES:
            folder = self.path / name
            folder.mkdir(exist_ok=True)
            for file in folder.glob("*.parquet"):
                file.unlink(missing_ok=True)  # another shard may make the same tables
        return self

    def __exit__(self, *_: object) -> None:
        self._flush()

    def write(self, name: str, tables: dict[str, TableRows]) -> None:
        """Adds the rows of a contract."""
        self.waiting.append(tables)
        self.names.append(name)
        if len(self.waiting) == self.together:
            self._flush()

    def _flush(self) -> None:
        if not self.waiting:
            return
        pa, parquet = _pyarrow()
        name = self.names[0] if self.together == 1 else f"from {self.names[0]}"
        for kind in TABLES:
            parts = [pa.table(_typed(pa, tables[kind])) for tables in self.waiting]
            parts = [part for part in parts if part.num_rows]
            if parts:
                table = pa.concat_tables(parts, promote_options="permissive")
                file = self.path / kind / f"{name}.parquet"
                with replacing(file, shared=True) as partial:
                    parquet.write_table(table, partial, compression="zstd")
        self.waiting, self.names = [], []


def _typed(pa: Any, rows: TableRows) -> dict[str, Any]:
    kinds = {"batch": pa.int32(), "trusted": pa.bool_()} | dict.fromkeys(NUMBERS, pa.float64())
    return {name: pa.array(x, kinds.get(name, pa.string())) for name, x in rows.items()}


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        message = 'pyarrow is missing: pip install "snapo[book]"'
        raise CaseError("book", "", None, message) from None
    return pyarrow, pyarrow.parquet


def query(path: Path, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """The columns and rows that a query on the `TABLES` in a book's folder returns.

    **Raises:** `CaseError` if DuckDB is missing, or refuses the query.
    """
    try:
        import duckdb
    except ImportError:
        message = 'duckdb is missing: pip install "snapo[book]"'
        raise CaseError("--sql", "", None, message) from None
    with duckdb.connect() as database:
        for name in TABLES:
            files = str((path / name).resolve() / "*.parquet").replace("'", "''")
            if list((path / name).glob("*.parquet")):
                database.execute(
                    f'CREATE VIEW "{name}" AS SELECT * FROM '
                    f"read_parquet('{files}', union_by_name = true)"
                )
        try:
            # A query reads these tables and nothing else of this machine.
            folder = str(path.resolve()).replace("'", "''")
            database.execute(f"SET allowed_directories = ['{folder}/']")
            database.execute("SET enable_external_access = false")
            result = database.execute(sql)
            return [column[0] for column in result.description or ()], result.fetchall()
        except duckdb.Error as error:
            raise CaseError("--sql", "", sql, str(error).splitlines()[0]) from None
