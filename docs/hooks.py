"""What mkdocs does beside reading pages: pages that live elsewhere in the project, facts of the families.

A page says `<!-- family: NAME -->` where the facts of a family belong. They are read from the library, so that
they cannot differ from it.
"""

import pathlib
import re

from mkdocs.structure.files import File

ROOT = pathlib.Path(__file__).parent.parent
ELSEWHERE = ("CHANGELOG.md", *(f"benchmarks/{name}.md" for name in ("README", "RESULTS", "MAPS", "PROJECTION", "DESIGN", "VERIFY")))


def on_files(files, config):
    """Add the pages that the project keeps outside `docs`."""
    for name in ELSEWHERE:
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Point links at the site instead of the project's folders, and put the facts of families in."""
    inside = page.file.src_uri.startswith("benchmarks/")
    markdown = markdown.replace("](../docs/", "](../") if inside else markdown.replace("](../benchmarks/", "](benchmarks/")
    # Notebooks are no pages of the site.
    markdown = re.sub(r"\[([^\]]+)\]\(((?:\.\./)*notebooks/[^)]+)\)", r"\1 (`\2`)", markdown)
    return re.sub(r"<!-- family: (\w+) -->", lambda found: facts(found[1]), markdown)


def facts(family: str) -> str:
    """A family's page below its title: its rule, its arms, its slots, its picture, its header."""
    import draw

    import ikjax
    from ikjax.arm.recognition.rules import RULES
    from ikjax.solvers.families import FAMILIES

    rule, arm = RULES[family], draw.ARMS[family]()
    catalogue = {name: ikjax.robots.get(name) for name in ikjax.robots.names()}
    members = [name for name, one in catalogue.items() if one.family == family]
    module = FAMILIES[family].branches.__module__
    lines = [f"{rule.summary[0].upper()}{rule.summary[1:]}.", ""]
    lines += ["| | |", "|---|---|", f"| joints, base to tool | {rule.joints} |", f"| task | `{rule.task}` |"]
    lines += [f"| arms of the catalogue | {', '.join(f'`{name}`' for name in members) or 'none'} |"]
    lines += [f"| slots | {len(arm.branches)} |", f"| file | `{module.replace('.', '/')}.py` |", ""]
    lines += ["## Which facts define it", "", f"As `ikjax.explain` finds them for {said(arm)}:", "", "```text"]
    lines += [line.strip() for line in ikjax.explain(arm).splitlines() if line.startswith("  yes")]
    lines += ["```", "", "## Slots", "", "| slot | bits, highest first | name |", "|---|---|---|"]
    width = max(len(arm.branches) - 1, 1).bit_length()
    lines += [f"| {k} | `{k:0{width}b}` | `{name}` |" for k, name in enumerate(arm.branches)]
    lines += ["", f"![Every branch of one goal of {said(arm)}](../pictures/{family}.png)", ""]
    lines += [f"*Every branch of one goal of {said(arm)}, by `ikjax.plot.branches`.*", ""]
    lines += ["## From the file", "", as_markdown(docstring(module))]
    return "\n".join(lines)


def said(arm) -> str:
    """How a sentence names an arm."""
    import ikjax

    return f"`{arm.name}`" if arm.name in ikjax.robots.names() else f"an arm of {arm.name}"


def docstring(module: str) -> str:
    """Of a module of the library."""
    import importlib
    import inspect

    return inspect.getdoc(importlib.import_module(module)) or ""


def as_markdown(text: str) -> str:
    """A docstring with the blank lines that Markdown wants around its lists, and its headings bold."""
    lines: list[str] = []
    for line in text.splitlines():
        item = bool(re.match(r"\d+\. ", line))
        inside = bool(lines) and bool(re.match(r"(\d+\. |   )", lines[-1]))
        starts = item and not inside and lines and lines[-1]
        ends = bool(line) and not item and not line.startswith("   ") and inside
        if starts or ends:
            lines.append("")
        lines.append(re.sub(r"^([A-Z]\w+):(?= |$)", r"**\1:**", line))
    return "\n".join(lines)
