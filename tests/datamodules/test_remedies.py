"""What a data module tells the user to give is given."""

from pathlib import Path
from typing import Any

import pytest

from envpred.datamodules import GridDataModule
from envpred.errors import UserError
from tests.remedies import remedy
from tests.store.stores import write_store

# What each option that a message names is given here.
GIVEN = {"--data.train": ["a"], "--data.val": ["b"], "--data.test": ["c"], "--data.length": 8, "--data.given": 3}


@pytest.mark.parametrize(
    ("options", "line", "together"),
    [
        ({"split": "quarters"}, "no split 'quarters'", True),
        ({"split": "custom", "train": ["a"]}, "leaves no drive to test", False),
        ({"length": 50, "test": ["c@-10"]}, "no window of 50 frames fits into c@0-10", False),
        ({"length": 50, "given": 45, "predict": "newest", "test": ["a"]}, "no window of 45 frames fits into a", False),
    ],
)
def test_options_that_a_message_names(tmp_path: Path, options: dict[str, Any], line: str, together: bool) -> None:
    store = write_store(tmp_path / "grids", {"a": list(range(30)), "b": list(range(30)), "c": list(range(60))})
    stage = "predict" if "predict" in options else "test"
    with pytest.raises(UserError, match=line) as failure:
        GridDataModule(store, **options).setup(stage)
    given = {name: GIVEN[name] for (name,) in remedy(failure.value)}
    for names in [list(given)] if together else [[name] for name in given]:
        changed = options | {name.removeprefix("--data."): given[name] for name in names}
        GridDataModule(store, **changed).setup(stage)
