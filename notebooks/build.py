"""Turn the scripts in this folder into notebooks, run them, and store them with their pictures.

A script is split at `# %%`; a cell that starts with `# %% [markdown]` is text. Run: make notebooks.
"""

import pathlib

import nbformat
from nbclient import NotebookClient

HERE = pathlib.Path(__file__).parent


def cells(text: str) -> list:
    """The cells of a script."""
    made = []
    for part in text.split("# %%")[1:]:
        if part.startswith(" [markdown]"):
            lines = part.removeprefix(" [markdown]").strip().splitlines()
            made.append(nbformat.v4.new_markdown_cell("\n".join(line.removeprefix("# ") for line in lines)))
        else:
            made.append(nbformat.v4.new_code_cell(part.strip()))
    return made


def build(script: pathlib.Path) -> pathlib.Path:
    """Run one script as a notebook and write the notebook next to it."""
    book = nbformat.v4.new_notebook(cells=cells(script.read_text()))
    for number, cell in enumerate(book.cells):
        cell["id"] = f"cell-{number}"
    book.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    NotebookClient(book, timeout=300, resources={"metadata": {"path": str(HERE)}}).execute()
    for cell in book.cells:
        cell.metadata.pop("execution", None)  # times of execution would change in every run
    path = script.with_suffix(".ipynb")
    nbformat.write(book, path)
    return path


if __name__ == "__main__":
    for script in sorted(HERE.glob("[0-9]*.py")):
        print(build(script))
