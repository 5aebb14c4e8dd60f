"""Pages of the numbered notebooks as they were run: ``python -m benchmarks.documents.notebooks``.

Each is run in a kernel of its own and becomes ``docs/notebooks/<name>/index.md``, its pictures files beside
it: so they are found in the repository as well as on the site.
"""

from __future__ import annotations

import argparse
import base64
import io
import re
import shutil
import tempfile
from pathlib import Path

import nbformat  # pyright: ignore[reportMissingImports]
from nbconvert import MarkdownExporter  # pyright: ignore[reportMissingImports]
from nbconvert.preprocessors import ExecutePreprocessor  # pyright: ignore[reportMissingImports]
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = ROOT / "examples" / "notebooks"
PAGES = ROOT / "docs" / "notebooks"

PICTURE = re.compile(r"data:image/png;base64,([A-Za-z0-9+/=]+)")
"""As notebooks hold them."""

DRAWING = re.compile(r"<svg.*?</svg>", re.DOTALL)


def main() -> None:
    """Run all, and write their pages."""
    shutil.rmtree(PAGES, ignore_errors=True)
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        page = write_page(path, PAGES / path.stem)
        size = sum(file.stat().st_size for file in page.parent.iterdir())
        print(f"{page.relative_to(ROOT)}: {size / 1e3:.0f} kB")


def write_page(path: Path, folder: Path) -> Path:
    """Run a notebook in an empty folder, and write what it shows to ``folder``."""
    folder.mkdir(parents=True)
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as work:
        ExecutePreprocessor(timeout=600).preprocess(notebook, {"metadata": {"path": work}})
    for number, cell in enumerate(notebook.cells):
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
            for output in cell.outputs:
                _tidy(output.get("data", {}), f"cell-{number}", folder)
    text, _ = MarkdownExporter().from_notebook_node(notebook)
    where = f"examples/notebooks/{path.name}"
    note = f"<!-- python -m benchmarks.documents.notebooks wrote this from {where} -->\n\n"
    page = folder / "index.md"
    page.write_text(note + re.sub(r"\n{3,}", "\n\n", text).strip() + "\n")
    return page


def _tidy(data: dict[str, str], name: str, folder: Path) -> None:
    """HTML of an output as part of a page: one block, its pictures files."""
    if "text/html" not in data:
        return

    def saved(found: re.Match[str]) -> str:
        picture = Image.open(io.BytesIO(base64.b64decode(found[1]))).convert("RGB")
        file = f"{name}.jpg"
        picture.save(folder / file, quality=85)
        return file

    def drawn(found: re.Match[str]) -> str:
        file = f"{name}.svg"
        (folder / file).write_text(found[0] + "\n")
        return f'<img src="{file}" alt="">'

    html = DRAWING.sub(drawn, PICTURE.sub(saved, data["text/html"]))
    data["text/html"] = "<div>" + re.sub(r"\n\s*\n", "\n", html) + "</div>"


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    main()
