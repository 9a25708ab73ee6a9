"""`boresight export --to latex`: tables that LaTeX itself sets, whatever characters their cells hold."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from boresight.campaign.cli import main
from boresight.reports.schema.grid import _SPECIAL, Grid

LATEX, FINDER = shutil.which("pdflatex"), shutil.which("kpsewhich")


def lacks_packages() -> bool:
    """Tell whether LaTeX is here without what the tables need."""
    names = ["booktabs.sty", "graphicx.sty"]
    return FINDER is None or subprocess.run([FINDER, *names], capture_output=True, check=False).returncode != 0


def test_latex_tables_have_whole_rows_and_no_bare_commands(tiny_run, tmp_path):
    assert main(["export", str(tiny_run.folder), "--to", "latex", "--out", str(tmp_path)]) == 0
    files = sorted(tmp_path.glob("*.tex"))
    assert files
    for file in files:
        text = file.read_text()
        body = text[text.index(r"\toprule") : text.index(r"\bottomrule")]
        columns = text.split(r"\begin{tabular}{")[1].split("}")[0]
        rows = [line for line in body.splitlines() if line.endswith(r" \\")]
        assert len(rows) > 1
        assert all(row.replace(r"\&", "").count("&") == len(columns) - 1 for row in rows)
    grid = Grid("A & B", ("50 %", "x_1"), ((r"a\b", "{1}"),))
    assert r"50 \% & x\_1 \\" in grid.latex()
    assert r"a\textbackslash{}b & \{1\} \\" in grid.latex()
    assert r"\caption{A \& B}" in grid.latex()


@pytest.mark.skipif(LATEX is None, reason="there is no pdflatex on the PATH")
@pytest.mark.skipif(LATEX is not None and lacks_packages(), reason="LaTeX is here without booktabs or graphicx")
def test_latex_sets_every_table_within_the_line(tiny_run, tmp_path):
    assert main(["export", str(tiny_run.folder), "--to", "latex", "--out", str(tmp_path / "tables")]) == 0
    every = "".join(_SPECIAL) + 'á [a] * "q"'
    odd = Grid(every, ("a", every), (("[0, 1]", every), ("*", "|"), ("x " * 200, "")), note=every)
    (tmp_path / "tables" / "odd.tex").write_text(odd.latex(), encoding="utf-8")
    tables = sorted((tmp_path / "tables").glob("*.tex"))
    lines = [r"\documentclass{article}", r"\usepackage{booktabs,graphicx}", r"\begin{document}"]
    lines += [rf"\input{{tables/{table.name}}}" for table in tables]
    (tmp_path / "main.tex").write_text("\n".join([*lines, r"\end{document}", ""]), encoding="utf-8")
    command = [LATEX, "-interaction=nonstopmode", "-halt-on-error", "main.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout[-2000:]
    log = (tmp_path / "main.log").read_text(encoding="utf-8", errors="replace")
    assert re.findall(r"(?:Overfull .*|Missing character.*|.*Warning.*)", log) == []
    captions = (tmp_path / "main.aux").read_text(encoding="utf-8").count(r"\contentsline {table}")
    assert captions == len(tables) > 3
