"""`optuna-dashboard` reads the storage, where it is installed."""

import json
import threading
import urllib.request
from pathlib import Path
from wsgiref.simple_server import WSGIRequestHandler, make_server

import optuna
import pytest

from sweeps.study.storage import JOURNAL, open_storage


class Quiet(WSGIRequestHandler):
    """A handler that logs nothing."""

    def log_message(self, format: str, *args: object) -> None:
        pass


def test_the_dashboard_shows_a_study(tmp_path: Path) -> None:
    dashboard = pytest.importorskip("optuna_dashboard", reason="pip install optuna-dashboard")
    study = optuna.create_study(storage=open_storage(tmp_path, None), study_name="prednet_dst_dogma")
    study.tell(study.ask(), 1.0)
    journal = optuna.storages.journal.JournalFileBackend(str(tmp_path / JOURNAL))  # as the command opens it
    with make_server(
        "127.0.0.1", 0, dashboard.wsgi(optuna.storages.JournalStorage(journal)), handler_class=Quiet
    ) as web:
        thread = threading.Thread(target=web.handle_request)
        thread.start()
        with urllib.request.urlopen(f"http://127.0.0.1:{web.server_port}/api/studies", timeout=30) as answer:
            studies = json.load(answer)["study_summaries"]
        thread.join()
    assert [study["study_name"] for study in studies] == ["prednet_dst_dogma"]
