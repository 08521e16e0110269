"""Whether LaTeX takes what a report writes: compiled where there is a compiler, and its structure anyway."""

import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

COMPILER = shutil.which("pdflatex")
PREAMBLE = "\\documentclass[10pt,twocolumn]{article}\n\\usepackage{booktabs}\n\\begin{document}\n"


def malformed(tex: str) -> list[str]:
    """What LaTeX would refuse or set wrongly in a table or a paragraph."""
    found = [f"not ASCII: {letter!r}" for letter in sorted(set(tex) - set(map(chr, range(128))))]
    plain = re.sub(r"\\[\\&%$#_{}]", "", tex)
    found += [] if plain.count("{") == plain.count("}") else ["braces do not match"]
    if plain.count("$") % 2 or "$$" in plain:
        found.append("dollars do not match")
    outside = "".join(plain.split("$")[::2])
    found += [f"{sign} as a letter" for sign in "<>|^_#%" if sign in outside]
    opened: list[str] = []
    for what, name in re.findall(r"\\(begin|end)\{([a-z*]+)\}", tex):
        if what == "begin":
            opened.append(name)
        elif not opened or opened.pop() != name:
            found.append(f"{name} is closed and was not opened")
    for kinds, body in re.findall(r"\\begin\{tabular\}\{((?:[lr]|p\{[^}]*\})*)\}(.*?)\\end\{tabular\}", tex, re.DOTALL):
        columns = len(re.findall(r"[lr](?![^{]*\})|p\{", kinds))
        rows = re.sub(r"\\(?:top|mid|bottom)rule", "", body).split("\\\\\n")[:-1]
        found += [f"{columns} columns, row {row!r}" for row in rows if len(re.findall(r"(?<!\\)&", row)) != columns - 1]
        found += [] if len(rows) > 2 else ["a table of one row"]
    return found


def compiled(texts: Sequence[str], folder: Path) -> str:
    """What pdflatex says of the texts in one document; empty if it takes them."""
    assert COMPILER is not None
    (folder / "all.tex").write_text(PREAMBLE + "\n\\clearpage\n".join(texts) + "\n\\end{document}\n", encoding="utf-8")
    command = [COMPILER, "-interaction=nonstopmode", "-halt-on-error", "all.tex"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", check=False)
    return "" if done.returncode == 0 else done.stdout[-1500:]
