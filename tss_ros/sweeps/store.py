"""A sweep on disk: a manifest of what is asked, done and failed, and the results as Parquet.

The manifest, an SQLite file, has a row for each finished job, written as it finishes, its results
included; now and then these go into Parquet files, each of which holds `BLOCK` jobs of one table
and is replaced as a whole. So whatever ends the process costs the jobs under way, no more, and
leaves no file that cannot be read.
"""

import fcntl
import json
import os
import sqlite3
import time
from collections.abc import Sized
from pathlib import Path
from typing import Any, Protocol

import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet

from tss_ros.core import TssError

#: File of a folder that tells what is asked, done and failed.
MANIFEST = "manifest.sqlite"
#: Jobs whose results share a file.
BLOCK = 10_000
#: Results go to Parquet after so many seconds, or so many jobs.
FLUSH_S, FLUSH_JOBS = 30.0, 10_000
TYPES = {
    float: pa.float64(),
    int: pa.int64(),
    bool: pa.bool_(),
    str: pa.string(),
    list[float]: pa.list_(pa.float64()),
    list[str]: pa.list_(pa.string()),
}
_SCHEMA = """
CREATE TABLE IF NOT EXISTS question (name TEXT PRIMARY KEY, value TEXT);
CREATE TABLE IF NOT EXISTS job (id INTEGER PRIMARY KEY, error TEXT, cpu_seconds REAL);
CREATE TABLE IF NOT EXISTS not_in_parquet (id INTEGER PRIMARY KEY, rows TEXT);
"""


class Asked(Sized, Protocol):
    """What has jobs with numbers from 0 on: `jobs.Question`, `ensemble.EnsembleQuestion`."""

    #: What it is called: "sweep" or "ensemble".
    name: str
    #: All that its results depend on.
    description: dict[str, Any]

    def job(self, number: int) -> Any:
        """The job of a number: its `run` gives what `jobs.Entry.run` does."""

    def label(self, number: int) -> str:
        """What a job is about, in words."""

    def columns(self) -> dict[str, dict[str, type]]:
        """Names and types of the columns of each table."""


class Store:
    """The folder of a sweep, new or to be gone on with; a context manager.

    Parameters
    ----------
    folder : Path
    question : Asked

    Raises
    ------
    TssError
        If the folder holds the sweep of another question, if another process works on it, or if
        the disk refuses.
    """

    def __init__(self, folder: Path, question: Asked) -> None:
        self._folder, self._manifest = folder, folder / MANIFEST
        self._name = question.name
        self._schemas = {
            name: pa.schema([(column, TYPES[kind]) for column, kind in columns.items()])
            for name, columns in question.columns().items()
        }
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._lock)
            raise TssError(f"another {question.name} is at work in {folder}") from None
        self._database = sqlite3.connect(self._manifest, isolation_level=None)
        try:
            # Each job is a transaction; the log survives the process without waiting for the disk.
            self._execute("PRAGMA journal_mode = WAL")
            self._execute("PRAGMA synchronous = NORMAL")
            for statement in _SCHEMA.split(";"):
                self._execute(statement)
            self._compare(question.description)
        except BaseException:
            self._close()
            raise
        self.done, self.failed = self._execute("SELECT count(*), count(error) FROM job").fetchone()
        self._pending, self._flushed = 0, time.monotonic()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self.flush()
        finally:
            self._close()

    def missing(self, total: int) -> list[int]:
        """Numbers of the jobs, of so many, that are not recorded."""
        recorded = {number for (number,) in self._execute("SELECT id FROM job")}
        return [number for number in range(total) if number not in recorded]

    def failures(self) -> sqlite3.Cursor:
        """Numbers and errors of the jobs that failed, in the order of the question."""
        return self._execute("SELECT id, error FROM job WHERE error IS NOT NULL ORDER BY id")

    def forget_failures(self) -> None:
        """Take the jobs that failed for missing."""
        self._execute("DELETE FROM job WHERE error IS NOT NULL")
        self.done, self.failed = self.done - self.failed, 0

    def record(self, number: int, rows: str, error: str | None, cpu_s: float) -> None:
        """Write down a job; its results survive the process from here on.

        Parameters
        ----------
        number : int
            A missing one: none can be recorded twice.
        rows : str
            Rows by table, as JSON.
        error : str or None
        cpu_s : float
            Processor time [s].
        """
        with self._database:
            self._execute("BEGIN")
            self._execute("INSERT INTO job VALUES (?, ?, ?)", (number, error, cpu_s))
            self._execute("REPLACE INTO not_in_parquet VALUES (?, ?)", (number, rows))
        self.done, self.failed = self.done + 1, self.failed + (error is not None)
        self._pending += 1
        if self._pending >= FLUSH_JOBS or time.monotonic() - self._flushed > FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Bring the Parquet files up to date."""
        blocks = self._execute("SELECT DISTINCT id / ? FROM not_in_parquet", (BLOCK,)).fetchall()
        for (block,) in blocks:
            part = "FROM not_in_parquet WHERE id BETWEEN ? AND ?"
            ends = block * BLOCK, (block + 1) * BLOCK - 1
            found = self._execute(f"SELECT id, rows {part} ORDER BY id", ends).fetchall()
            numbers, texts = zip(*found)
            tables = [json.loads(text) for text in texts]
            for name in self._schemas:
                rows = [row for table in tables for row in table.get(name, ())]
                self._replace(name, block, numbers, rows)
            self._execute(f"DELETE {part}", ends)
        self._pending, self._flushed = 0, time.monotonic()

    def table(self, name: str, columns: list[str] | None = None) -> pa.Table:
        """A table as it stands in Parquet, in the order of the question.

        Parameters
        ----------
        name : str
        columns : list of str, optional
            All if not given.

        Returns
        -------
        pyarrow.Table
        """
        if not (self._folder / name).is_dir():
            empty = self._schemas[name].empty_table()
            return empty.select(columns) if columns else empty
        return pa.parquet.read_table(self._folder / name, columns=columns)

    def _replace(self, name, block, numbers, rows):
        """Put the rows of some jobs into the file of their block."""
        path = self._folder / name / f"part-{block:06d}.parquet"
        table = pa.Table.from_pylist(rows, self._schemas[name])
        if path.exists():
            # The cast drops what reading adds to the schema, so that equal rows give equal files.
            old = pa.parquet.read_table(path).cast(self._schemas[name])
            known = pa.compute.is_in(old["job"], pa.array(numbers, pa.int64()))
            table = pa.concat_tables([old.filter(pa.compute.invert(known)), table])
            table = table.sort_by("job").combine_chunks()
        elif not rows:
            return
        path.parent.mkdir(exist_ok=True)
        # Readers of the folder pass over names that begin with a dot.
        new = path.with_name(f".{path.stem}.new")
        with new.open("wb") as file:
            pa.parquet.write_table(table, file, compression="zstd")
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
        folder = os.open(path.parent, os.O_RDONLY)
        os.fsync(folder)  # the manifest lets go of these rows next
        os.close(folder)

    def _compare(self, description):
        """Write down the question, or refuse one that differs from what is written."""
        asked = {name: json.dumps(value) for name, value in description.items()}
        known = dict(self._execute("SELECT name, value FROM question"))
        if not known:
            self._execute(
                "INSERT INTO question SELECT key, value FROM json_each(?)", (json.dumps(asked),)
            )
            return
        differ = [
            f"{name} is {_short(known.get(name))} there and {_short(asked.get(name))} here"
            for name in sorted(known.keys() | asked.keys())
            if known.get(name) != asked.get(name)
        ]
        if differ:
            raise TssError(f"{self._folder} holds another {self._name}: {'; '.join(differ)}")

    def _execute(self, statement, values=()):
        try:
            return self._database.execute(statement, values)
        except sqlite3.Error as error:
            raise TssError(f"{self._manifest}: {error}") from None

    def _close(self):
        self._database.close()
        os.close(self._lock)


def _short(value):
    if value is None:
        return "nothing"
    return value if len(value) <= 100 else f"another one, {value[:40]}..."
