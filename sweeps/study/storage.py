"""Where a study is kept: a journal in a shared folder, or a database."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from optuna.storages import BaseStorage, JournalStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend, JournalFileSymlinkLock

from envpred.errors import UserError, one_line

JOURNAL = "journal.log"
CONNECT_SECONDS = 10


class TidyLock(JournalFileSymlinkLock):
    """The journal's lock; whoever gets it first cuts off what a killed writer or a full disk left of a line.

    The next line would else be written onto it, and neither could ever be read.
    """

    def __init__(self, journal: Path) -> None:
        super().__init__(str(journal))
        self.journal = journal

    def acquire(self) -> bool:
        held = super().acquire()
        try:
            self._cut_torn_line()
        except BaseException:
            self.release()
            raise
        return held

    def _cut_torn_line(self) -> None:
        with self.journal.open("rb+") as file:
            end = file.seek(0, 2)
            if end == 0:
                return
            file.seek(end - 1)
            if file.read(1) != b"\n":
                file.seek(0)
                file.truncate(file.read().rfind(b"\n") + 1)


def open_storage(folder: Path, url: str | None) -> BaseStorage:
    """The storage at `url` (as SQLAlchemy takes it), by default a journal in `folder`.

    Raises:
        UserError: if it cannot be reached, or written.
    """
    if url is None:
        with told(folder):
            folder.mkdir(parents=True, exist_ok=True)
            journal = folder / JOURNAL
            try:
                _check_last_line(journal)
                return JournalStorage(JournalFileBackend(str(journal), TidyLock(journal)))
            except (ValueError, TypeError, LookupError, AttributeError, AssertionError) as error:
                raise UserError(
                    f"{journal}: damaged, its lines do not tell a study ({one_line(error)}); get it from a backup, or "
                    "begin anew under another name"
                ) from None
    try:
        options = {"pool_pre_ping": True}
        if url.startswith("postgresql"):
            options["connect_args"] = {"connect_timeout": CONNECT_SECONDS}  # type: ignore[assignment]
        with told(folder, url):
            return RDBStorage(url, engine_kwargs=options)
    except ImportError as error:
        raise UserError(
            f"--storage {hidden(url)}: its driver is not installed ({error}); "
            "for PostgreSQL pip install 'envpred[postgresql]'"
        ) from None


def _check_last_line(journal: Path) -> None:
    """Raise ValueError for a last line that is whole but cannot be read: Optuna finds that with the next line."""
    content = journal.read_bytes() if journal.exists() else b""
    if content.endswith(b"\n"):
        json.loads(content[content.rfind(b"\n", 0, -1) + 1 :])


@contextmanager
def told(folder: Path, url: str | None = None) -> Iterator[None]:
    """Turn what a storage says when it fails, or the disk when it is full, into one line."""
    from optuna.exceptions import StorageInternalError
    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except OSError as error:
        raise UserError(
            f"{error.filename or folder}: {error.strerror or error}; make room or give another --out, "
            "then run the same command again to go on"
        ) from None
    except (StorageInternalError, SQLAlchemyError) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise UserError(
            f"--storage {hidden(url or '')}: not reachable ({reason[:300]}); start it, or mend its URL"
        ) from None


def hidden(url: str) -> str:
    """`url` without its password."""
    head, at, tail = url.rpartition("@")
    scheme, slashes, login = head.partition("://")
    return f"{scheme}{slashes}{login.split(':', 1)[0]}{at}{tail}" if at else url
