"""Plate tables of the Planetary Data System, as text.

Two layouts exist, both read here:

- `v`/`f` records (SPICE MKDSK format 3): ``v x y z`` lines, then ``f i j k`` lines;
- counted tables (MKDSK format 1): the number of vertices, lines ``n x y z``, the number of plates, lines ``n i j k``.
"""

from __future__ import annotations

from scenarios.bodies.readers.source import FloatArray, RawShape, ShapeFile


def read_plates(source: ShapeFile) -> RawShape:
    """Read a PDS plate table; indices may start at 0 or at 1.

    The `v`/`f` layout looks like an OBJ file but the base of its indices varies between products
    (1 in 1620geographos.tab, 0 in eros022540.tab): a file that uses index 0 counts from 0.
    """
    lines = source.lines()
    first = lines[source.filled(lines)[0]].split()
    vertices, faces = _tagged(source, lines) if first[0] in ("v", "f", "#") else _counted(source, lines)
    base = 0 if len(faces) and faces.min() == 0 else 1
    return source.shape(vertices, faces - base)


def _tagged(source: ShapeFile, lines: list[str]) -> tuple[FloatArray, FloatArray]:
    rows: dict[str, list[int]] = {"v": [], "f": []}
    for i, line in enumerate(lines):
        tag = line.split(maxsplit=1)[0] if line.strip() else "#"
        if tag in rows:
            rows[tag].append(i)
        elif not tag.startswith("#"):
            raise source.fault(f"a line of a plate table starts with v or f, not {tag[:40]!r}", i + 1)
    return source.table(lines, rows["v"], (1, 2, 3)), source.table(lines, rows["f"], (1, 2, 3))


def _counted(source: ShapeFile, lines: list[str]) -> tuple[FloatArray, FloatArray]:
    filled = source.filled(lines)
    n_vertices = _count(source, lines, filled, 0)
    n_plates = _count(source, lines, filled, n_vertices + 1)
    end = n_vertices + n_plates + 2
    if len(filled) != end:
        raise source.fault(f"{n_vertices} vertices and {n_plates} plates need {end} lines, found {len(filled)}")
    columns = (1, 2, 3)
    vertices = source.table(lines, filled[1 : n_vertices + 1], columns)
    return vertices, source.table(lines, filled[n_vertices + 2 :], columns)


def _count(source: ShapeFile, lines: list[str], filled: list[int], at: int) -> int:
    if at >= len(filled):
        raise source.fault(f"the table ends after {len(filled)} lines, before its count of plates; is the file cut?")
    word = lines[filled[at]].strip()
    if not (word.isascii() and word.isdigit() and len(word) < 16):
        raise source.fault(f"expected a count, found {word[:40]!r}; check body.format", filled[at] + 1)
    return int(word)
