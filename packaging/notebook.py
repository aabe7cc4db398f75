"""Makes the notebook docs/tutorial.ipynb of the page docs/tutorial.md, which is the source of both.

    python3 packaging/notebook.py                     writes the notebook
    python3 packaging/notebook.py --check             fails where it is not that of the page
    python3 packaging/notebook.py --run [PICTURES]    runs it in an empty folder, by nbclient; pictures go into the folder PICTURES

Blocks of Python become cells of code, and blocks of sh cells that a shell runs, unless the page's tests do not run them; all else becomes
text. Excerpts of what a command prints are left out, since a notebook has it itself.
"""

import base64
import json
import os
import pathlib
import re
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAGE, NOTEBOOK = ROOT / "docs/tutorial.md", ROOT / "docs/tutorial.ipynb"


# A block, with the comment above it that says more of it.
BLOCK = re.compile(r"(?:^<!-- ([^\n]*) -->\n)?^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^(?=#+ )", re.MULTILINE)


def cells(text):
    """Kinds and texts of the cells: one a heading with what follows it, one a block."""
    at = 0
    for block in [*BLOCK.finditer(text), None]:
        prose = text[at : block.start() if block else len(text)]
        yield from (("markdown", part.strip()) for part in HEADING.split(prose) if part.strip())
        if block is None:
            return
        at = block.end()
        note, language, body = block.groups()
        body = body.rstrip("\n")
        if language == "python":
            yield "code", body
        elif language == "sh" and note is None:
            yield "code", f"%%sh\n{body}"
        elif not (note or "").startswith("output of:"):
            yield "markdown", f"```{language}\n{body}\n```"


def notebook(text):
    def cell(number, kind, source):
        of_code = {"execution_count": None, "outputs": []} if kind == "code" else {}
        lines = source.splitlines(keepends=True)
        return {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, **of_code, "source": lines}

    return {
        "cells": [cell(number, *one) for number, one in enumerate(cells(text), 1)],
        "metadata": {
            "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
            "language_info": {"name": "python"},
        },
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def written(text):
    return json.dumps(notebook(text), indent=1, ensure_ascii=False) + "\n"


def check():
    if not NOTEBOOK.exists() or NOTEBOOK.read_text() != written(PAGE.read_text()):
        sys.exit(f"error: {NOTEBOOK} is not made of {PAGE.name} as it is now: run python3 packaging/notebook.py")


def run(pictures):
    import nbclient
    import nbformat

    check()
    os.environ.setdefault("BELFRY_REPOSITORY", str(ROOT))
    # The kernel and its shell find the program beside this Python.
    os.environ["PATH"] = os.pathsep.join([str(pathlib.Path(sys.executable).parent), os.environ.get("PATH", "")])
    made = nbformat.read(NOTEBOOK, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        nbclient.NotebookClient(made, timeout=900, resources={"metadata": {"path": folder}}).execute()
    outputs = [output for cell in made.cells if cell.cell_type == "code" for output in cell.outputs]
    shown = [output.data for output in outputs if "data" in output]
    images = [data["image/png"] for data in shown if "image/png" in data]
    for number, image in enumerate(images, 1):
        if pictures:
            pathlib.Path(pictures).mkdir(parents=True, exist_ok=True)
            (pathlib.Path(pictures) / f"tutorial_{number}.png").write_bytes(base64.b64decode(image))
    if pictures:
        text = "".join(output.text for output in outputs if output.output_type == "stream")
        (pathlib.Path(pictures) / "tutorial.txt").write_text(text)
    count = sum(cell.cell_type == "code" for cell in made.cells)
    print(f"{NOTEBOOK.name}: {count} cells were run, {len(images)} pictures")
    if not images:
        sys.exit("error: the tutorial has no pictures")


if __name__ == "__main__":
    words = sys.argv[1:]
    if not words:
        NOTEBOOK.write_text(written(PAGE.read_text()))
        print(NOTEBOOK)
    elif words == ["--check"]:
        check()
    elif words[0] == "--run" and len(words) <= 2:
        run(words[1] if len(words) == 2 else None)
    else:
        sys.exit(__doc__)
