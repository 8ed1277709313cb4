"""What the site has beside the pages: those made from docstrings and fields, and links to files that are no pages.

A hook of mkdocs; see mkdocs.yml and site.md.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
GUIDE = Path(__file__).resolve().parent
TUTORIALS = sorted(path.stem for path in GUIDE.glob("*.py") if path.read_text().startswith("# %%"))
FRAME = "::: {}\n"


def on_config(config):
    config.docs_dir = str(ROOT / "examples")
    return config


def on_files(files, config):
    """Adds the pages that are made. The README is the home, the index of examples/ a page beside it."""
    files.remove(files.get_file_from_path("README.md"))
    readme, index = ((ROOT / place / "README.md").read_text() for place in ("", "examples"))
    home = re.sub(r"(\]\(|src=\")examples/", r"\1", readme).replace("](README.md)", "](overview.md)")
    home = home.replace('height="420"', 'style="max-height: 420px"')  # the theme overrules heights
    files.append(File.generated(config, "index.md", content=home))
    files.append(File.generated(config, "overview.md", content=index.replace("](../README.md)", "](index.md)")))
    for name, text in made().items():
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    for name in TUTORIALS:
        text = tutorial((GUIDE / f"{name}.py").read_text())
        files.append(File.generated(config, f"guide/{name}_tutorial.md", content=text))
    return files


def on_page_markdown(markdown, page, config, files):
    """Links to files that are no pages, scripts and what lies outside examples/, are told as their names."""

    def told(match):
        text, link = match.groups()
        path = posixpath.normpath(posixpath.join(posixpath.dirname(page.file.src_uri), link.partition("#")[0]))
        if path in (f"guide/{name}.py" for name in TUTORIALS):
            return f"[{text}]({link.removesuffix('.py')}_tutorial.md)"
        if path.endswith(".py"):
            return f"`{posixpath.normpath(posixpath.join('examples', path))}`"
        return match[0] if link.startswith(("https://", "#")) or files.get_file_from_path(path) else text

    return re.sub(r"(?<!!)\[([^\[\]]+)\]\(([^()\s]+)\)", told, markdown)


def tutorial(source: str) -> str:
    """A script of `# %%` cells as a page."""
    lines = []
    for cell in re.split(r"^# %%", source, flags=re.MULTILINE)[1:]:
        kind, _, text = cell.partition("\n")
        if "markdown" in kind:
            lines.append(re.sub(r"^# ?", "", text.strip("\n"), flags=re.MULTILINE))
        else:
            lines.append(f"```python\n{text.strip()}\n```")
    return "\n\n".join(lines) + "\n"


def made() -> dict[str, str]:
    """Name -> text of each page that is made: a reference of the case file, and public names with their docstrings."""
    import axijax
    import calibrate
    from axijax import theory

    return {
        "case_file": case_file(),
        "axijax": names("axijax", [name for name in axijax.__all__ if name != "theory"], axijax.__doc__),
        "theory": names("axijax.theory", sorted(theory.__all__), theory.__doc__),
        "calibrate": names("calibrate", calibrate.__all__, calibrate.__doc__),
    }


def names(package: str, public: list[str], doc: str) -> str:
    """A page of a package's public names. The module in which each is defined is asked, since names are loaded late."""
    from importlib import import_module

    lines = [f"# {package}", "", doc.partition("\n\n")[0], ""]
    for name in public:
        found = getattr(import_module(package), name)
        if not hasattr(found, "__qualname__"):  # a constant
            lines += [f"## {name}", "", f"`{found!r}`", ""]
        else:
            lines.append(FRAME.format(f"{found.__module__}.{found.__qualname__}"))
    return "\n".join(lines)


def case_file() -> str:
    """The case file of each kind of specimen, as `axijax new` writes it from the fields' own declarations."""
    from axijax.app.case import KINDS, default_case
    from axijax.app.case_writing import to_toml

    lines = [
        "# The case file", "",
        "As `axijax new --kind KIND` writes it: every field with its meaning, unit, what is allowed and its default. "
        "A line that is left out takes its default.", "",
    ]  # fmt: skip
    for kind in KINDS:
        if kind == "file":  # of one's own packing: no default can be written
            continue
        lines += [f"## {kind}", "", "```toml", to_toml(default_case(kind)).rstrip("\n"), "```", ""]
    return "\n".join(lines)
