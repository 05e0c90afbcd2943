"""What mkdocs does beside reading pages: pages that live elsewhere in the project, facts of the families.

A page has marks where something of the project belongs, so that it cannot differ from it:

    <!-- families -->                  the table of all families
    <!-- family: NAME -->              the facts of one
    <!-- header: MODULE -->            the docstring of a module
    <!-- source: PATH NAME [KEY] -->   a function, class or constant, or one entry of a dictionary
    <!-- catalogue -->                 every robot of the tables in a line
    <!-- table: ROBOT -->              the table of one
"""

import ast
import pathlib
import re
import textwrap

from mkdocs.structure.files import File

ROOT = pathlib.Path(__file__).parent.parent
ELSEWHERE = (
    "CHANGELOG.md",
    *(f"benchmarks/{name}.md" for name in ("README", "RESULTS", "MAPS", "PROJECTION", "DESIGN", "VERIFY")),
)


def on_files(files, config):
    """Add the pages that the project keeps outside `docs`."""
    for name in ELSEWHERE:
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Point links at the site instead of the project's folders, and put the facts of families in."""
    inside = page.file.src_uri.startswith("benchmarks/")
    markdown = (
        markdown.replace("](../docs/", "](../")
        if inside
        else markdown.replace("](../benchmarks/", "](benchmarks/")
    )
    # Notebooks are no pages of the site.
    markdown = re.sub(r"\[([^\]]+)\]\(((?:\.\./)*notebooks/[^)]+)\)", r"\1 (`\2`)", markdown)
    markdown = re.sub(r"<!-- header: ([\w.]+) -->", lambda found: as_markdown(docstring(found[1])), markdown)
    markdown = re.sub(
        r"<!-- source: (\S+) (\w+)(?: (\w+))? -->", lambda found: source(*found.groups()), markdown
    )
    markdown = markdown.replace("<!-- families -->", overview() if "<!-- families -->" in markdown else "")
    markdown = markdown.replace("<!-- catalogue -->", catalogue() if "<!-- catalogue -->" in markdown else "")
    markdown = re.sub(r"<!-- table: (\w+) -->", lambda found: table(found[1]), markdown)
    return re.sub(r"<!-- family: (\w+) -->", lambda found: facts(found[1]), markdown)


def facts(family: str) -> str:
    """A family's page below its title: its rule, its arms, its slots, its picture, its header."""
    import sys

    import ikjax
    from ikjax.arm.recognition.rules import RULES
    from ikjax.solvers.families import FAMILIES

    sys.path.insert(0, str(pathlib.Path(__file__).parent))
    import draw

    rule, arm = RULES[family], draw.ARMS[family]()
    catalogue = {name: ikjax.robots.get(name) for name in ikjax.robots.names()}
    members = [name for name, one in catalogue.items() if one.family == family]
    module = FAMILIES[family].branches.__module__
    lines = [f"{rule.summary[0].upper()}{rule.summary[1:]}.", ""]
    lines += ["| | |", "|---|---|", f"| joints, base to tool | {rule.joints} |", f"| task | `{rule.task}` |"]
    lines += [f"| arms of the catalogue | {', '.join(f'`{name}`' for name in members) or 'none'} |"]
    lines += [f"| slots | {len(arm.branches)} |", f"| file | `{module.replace('.', '/')}.py` |", ""]
    lines += [
        "## Which facts define it",
        "",
        f"As `ikjax.explain` finds them for {said(arm)}:",
        "",
        "```text",
    ]
    lines += [line.strip() for line in ikjax.explain(arm).splitlines() if line.startswith("  yes")]
    lines += ["```", "", "## Slots", "", "| slot | bits, highest first | name |", "|---|---|---|"]
    width = max(len(arm.branches) - 1, 1).bit_length()
    lines += [f"| {k} | `{k:0{width}b}` | `{name}` |" for k, name in enumerate(arm.branches)]
    lines += ["", f"![Every branch of one goal of {said(arm)}](../pictures/{family}.png)", ""]
    caption = f"Every branch of one goal of {said(arm)}, by `ikjax.plot.branches`."
    lines += [f"*{caption} Figures that look alike differ in how links are turned about themselves.*", ""]
    lines += ["## Frames, steps, bits and source", "", as_markdown(docstring(module))]
    return "\n".join(lines)


def overview() -> str:
    """Every family in a line."""
    from ikjax.arm.recognition.rules import RULES

    lines = ["| family | joints | arms | task |", "|---|---|---|---|"]
    lines += [f"| [{name}]({name}.md) | {r.joints} | {r.summary} | `{r.task}` |" for name, r in RULES.items()]
    return "\n".join(lines)


def catalogue() -> str:
    """Every robot of the tables: its name, what it is, its family, its source."""
    import ikjax
    from ikjax.arm.robots.tables import tables

    lines = ["| name | robot | family | source |", "|---|---|---|---|"]
    for name in sorted(tables()):
        facts = ikjax.robots.about(name)
        words = [facts["title"], facts.get("note", "")]
        family = ikjax.robots.get(name).family
        lines.append(f"| `{name}` | {'. '.join(filter(None, words))} | `{family}` | {facts['source']} |")
    return "\n".join(lines)


def table(robot: str) -> str:
    """A robot's table as it stands in its file."""
    for file in sorted((ROOT / "ikjax/arm/robots/tables").glob("*.toml")):
        found = re.search(rf"^\[{robot}\]\n.*?(?=^\[\w+\]$|\Z)", file.read_text(), re.S | re.M)
        if found:
            return f"```toml\n{found[0].strip()}\n```"
    raise ValueError(f"no table of {robot}: a page of the documentation shows it")


def source(path: str, name: str, key: str | None = None) -> str:
    """A function, class or constant of a file as a block of code; of a dictionary the entry of one key."""
    text = (ROOT / path).read_text()
    for node in ast.parse(text).body:
        target = getattr(node, "targets", [getattr(node, "target", node)])[0]
        if name not in (getattr(target, "id", None), getattr(node, "name", None)):
            continue
        lines = text.splitlines()
        first = min([node.lineno, *(each.lineno for each in getattr(node, "decorator_list", []))])
        last = node.end_lineno
        if key is not None:
            entries = zip(node.value.keys, node.value.values, strict=True)
            first, last = next((k.lineno, v.end_lineno) for k, v in entries if k.value == key)
        code = textwrap.dedent("\n".join(lines[first - 1 : last]))
        return f"```{{.python .norun title='{path}'}}\n{code}\n```"
    raise ValueError(f"{path} has no {name}: a page of the documentation shows it")


def said(arm) -> str:
    """How a sentence names an arm."""
    import ikjax

    return f"`{arm.name}`" if arm.name in ikjax.robots.names() else "an arm made for this page"


def docstring(module: str) -> str:
    """Of a module of the library."""
    import importlib
    import inspect

    return inspect.getdoc(importlib.import_module(module)) or ""


def as_markdown(text: str) -> str:
    """A docstring with the blank lines that Markdown wants around its lists, and its headings bold."""
    lines: list[str] = []
    inside = False
    for line in text.splitlines():
        # Elsewhere a number at the beginning of a line is the end of a sentence.
        item = re.match(r"(\d+\.) " if inside else r"(1\.) ", line)
        ends = inside and line and not item and not line.startswith("   ")
        if lines and lines[-1] and (ends or (item and not inside)):
            lines.append("")
        inside = bool(item) or (inside and not ends)
        # Markdown would count for itself.
        line = f"- **{item[1]}** {line[item.end() :]}" if item else line
        lines.append(re.sub(r"^([A-Z]\w+):(?= |$)", r"**\1:**", line))
    return "\n".join(lines)
