"""Names of methods that the user gives instead of those that their results give them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from envpred.errors import UserError
from envpred.report.run import Run
from envpred.report.runs import with_distinct_labels
from envpred.report.seeds import groups


def labelled(runs: Sequence[Run], labels: Sequence[str]) -> list[Run]:
    """The runs, some of them called otherwise; with a run all that differ from it in their seed alone.

    Args:
        runs: of a report.
        labels: `RUN=NAME` each, a run being its result file, or a folder that holds it.

    Raises:
        UserError: if one is none, names no run or several methods, or leaves two methods one name.
    """
    methods, given = groups(runs), dict[int, str]()
    for label in labels:
        path, _, name = (part.strip() for part in label.partition("="))
        if not (path and name):
            raise UserError(f"--label {label}: give a run's folder and its name, as in runs/test/mine/version_0=Ours")
        found = [n for n, group in enumerate(methods) if any(_within(run.file, Path(path)) for run in group)]
        if not found:
            raise UserError(f"--label {label}: {path} is none of the runs in this report; name the folder of one")
        if len(found) > 1:
            raise UserError(f"--label {label}: {path} holds runs of {len(found)} methods; name the folder of one")
        if given.setdefault(found[0], name) != name:
            raise UserError(f"--label {label}: {path} is called {given[found[0]]} already; give it one name")
    for n, name in given.items():
        for other, group in enumerate(methods):
            if n != other and given.get(other, group[0].method) == name:
                files = f"{methods[n][0].file.parent} and {group[0].file.parent}"
                raise UserError(f"--label: {files} are both called {name}; give each a name of its own")
    names = {run.file: name for n, name in given.items() for run in methods[n]}
    return with_distinct_labels([replace(run, method=names.get(run.file, run.method)) for run in runs])


def _within(file: Path, path: Path) -> bool:
    """Whether a file is `path`, or lies in it."""
    return path.resolve() in (file.resolve(), *file.resolve().parents)
