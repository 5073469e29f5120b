"""Build of the site: pages of modules and sources, links valid in repository and site, equations as MathML."""

import ast
import html
import json
import os
import re
from pathlib import Path, PurePosixPath
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from python_modules import dotted, first_line, modules

ROOT = Path(__file__).resolve().parent.parent.parent
PROJECT = {
    "README.md": "index.md",
    "SECURITY.md": "project/security.md",
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
} | {
    f"extensions/{path.parent.name}/README.md": f"extensions/{path.parent.name}.md"
    for path in ROOT.glob("extensions/*/README.md")
}
"""Pages at the repository's root or in an extension, with their address in the site."""

SHIM = "assets/iframe-worker.js"

_LINK = re.compile(
    r"^ *(`{3,}).*?^ *\1 *$|`[^`\n]+`|\]\((?P<to>[^)\s]+)\)", re.DOTALL | re.MULTILINE
)
"""A link, or code, which contains no links."""
_MATH = re.compile(r'<(span|div) class="arithmatex">\s*\\([(\[])(.*?)\\[)\]]\s*</\1>', re.DOTALL)
_FUNCTION = re.compile(r"(\[`([\w.]+)`\]\([^)#\s]+\.py)\)")
"""Link from a function's full name to its file."""


def _api(file: str) -> str:
    return f"reference/api/{dotted(file)}.md"


def _api_page(file: str) -> str:
    name = dotted(file)
    if name != "outrider":
        return f"# {name}\n\n::: {name}\n"
    text = (ROOT / file).read_text(encoding="utf-8")
    (where,) = (
        ast.literal_eval(node.value)
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "_WHERE"
    )
    parts = [
        f"## outrider.{one}\n\n::: {module}.{one}\n    options:\n      heading_level: 3\n"
        for one, module in where.items()
    ]
    return "# outrider\n\n" + first_line(file) + "\n\n" + "\n".join(parts)


def _source_page(path: str) -> str:
    """Return a file of the repository, or the files of a folder, as a page."""
    place = ROOT / path
    shown = [place] if place.is_file() else sorted(one for one in place.iterdir() if one.is_file())
    parts = [f"# {path}"]
    for one in shown:
        text = one.read_text(encoding="utf-8")
        if one.suffix == ".md":
            parts.append(text.partition("\n")[2])
            continue
        if one.suffix == ".ipynb":
            parts.append(_notebook(text))
            continue
        language = {".py": "python", ".toml": "toml", ".yml": "yaml", ".c": "c"}.get(
            one.suffix, "text"
        )
        heading = f"## {one.name}\n\n" if len(shown) > 1 else ""
        parts.append(f"{heading}````{language}\n{text}\n````")
    return "\n\n".join(parts)


def _notebook(text: str) -> str:
    """Return the cells of a notebook as Markdown; its first heading becomes one of the second level."""
    cells = [(one["cell_type"], "".join(one["source"])) for one in json.loads(text)["cells"]]
    shown = (f"```python\n{cell}\n```" if kind == "code" else cell for kind, cell in cells)
    return "\n\n".join(shown).replace("# ", "## ", 1)


_ORIGIN: dict[str, str] = {}
"""Pages from files outside docs: address in the site, and file."""


def _site_address(repository_path: str) -> str:
    """Return the address of a repository file in the site."""
    if repository_path.startswith("docs/"):
        return repository_path.removeprefix("docs/")
    if repository_path in PROJECT:
        return PROJECT[repository_path]
    if any(repository_path in files for files in modules().values()):
        return _api(repository_path)
    return (
        f"source/{repository_path}.md"
        if not repository_path.endswith(".md")
        else f"source/{repository_path}"
    )


def _targets(text: str, origin: str) -> list[str]:
    """Return the repository files that a page links to."""
    folder = os.path.dirname(origin)
    links = (found["to"] or "" for found in _LINK.finditer(text))
    files = (link.partition("#")[0] for link in links if not re.match(r"[a-z]+:", link))
    return [os.path.normpath(os.path.join(folder, file)) for file in files if file]


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the modules' pages to the navigation."""
    for section in config.nav or []:
        if "Reference" in section:
            groups = [
                {group: [{dotted(file): _api(file)} for file in files]}
                for group, files in modules().items()
            ]
            place = section["Reference"].index("reference/python.md")
            section["Reference"][place] = {
                "Python": [{"All modules": "reference/python.md"}, *groups]
            }
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    waiting: dict[str, str] = {}
    for path, address in PROJECT.items():
        _ORIGIN[address] = path
        files.append(File.generated(config, address, content=(ROOT / path).read_text("utf-8")))
    for group in modules().values():
        for file in group:
            files.append(File.generated(config, _api(file), content=_api_page(file)))
    for file in files.documentation_pages():
        origin = _ORIGIN.get(file.src_uri, f"docs/{file.src_uri}")
        if not file.src_uri.startswith("reference/api/"):
            waiting |= dict.fromkeys(_targets(file.content_string, origin), origin)
    done: set[str] = set()
    while waiting:
        path, _ = waiting.popitem()
        address = _site_address(path)
        if path in done or not address.startswith("source/") or not (ROOT / path).exists():
            continue
        done.add(path)
        _ORIGIN[address] = path
        content = _source_page(path)
        files.append(File.generated(config, address, content=content))
        if path.endswith(".md"):
            waiting |= dict.fromkeys(_targets(content, path), path)
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Redirect links to repository files to their pages."""
    here = page.file.src_uri
    if here == "index.md":
        page.meta["hide"] = ["navigation"]
    origin = _ORIGIN.get(here, f"docs/{here}")

    def lead(found: re.Match[str]) -> str:
        file, mark, heading = (found["to"] or "").partition("#")
        if not file or re.match(r"[a-z]+:", file):
            return found[0]
        path = os.path.normpath(os.path.join(os.path.dirname(origin), file))
        address = _site_address(path)
        if files.get_file_from_path(address) is None and not path.startswith("docs/"):
            raise PluginError(f"{origin}: link to {found['to']}: no such file")
        relative = os.path.relpath(address, PurePosixPath(here).parent)
        return f"]({relative}{mark}{heading})"

    if here.startswith(("reference/api/", "source/")) and not origin.endswith(".md"):
        return markdown
    return _LINK.sub(lead, _FUNCTION.sub(r"\1#\2)", markdown))


def on_page_content(content: str, **_: Any) -> str:
    """Convert equations to MathML, which browsers display natively."""

    def draw(found: re.Match[str]) -> str:
        tag, bracket, tex = found.groups()
        words = re.sub(r"_\{([a-z,]{2,})\}", r"_{\\mathrm{\1}}", html.unescape(tex))
        drawn = convert(words, display="block" if bracket == "[" else "inline")
        return f'<{tag} class="arithmatex">{drawn}</{tag}>'

    return _MATH.sub(draw, content)


def on_post_page(output: str, *, page: Page, **_: Any) -> str:
    """Load the search's shim from the site, and check that nothing else comes from the network."""
    return _offline(output, os.path.relpath(SHIM, PurePosixPath(page.file.dest_uri).parent))


def on_post_template(output_content: str, *, template_name: str, **_: Any) -> str:
    """Apply the same to the error page."""
    return (
        _offline(output_content, f"/{SHIM}") if template_name.endswith(".html") else output_content
    )


def _offline(output: str, shim: str) -> str:
    text = output.replace("https://unpkg.com/iframe-worker/shim", shim)
    foreign = re.search(r'<(script|img|link|iframe)[^>]+(src|href)="?(https?:)?//[^>]*>', text)
    if foreign:
        raise PluginError(f"the site must work offline, but loads {foreign[0]}")
    return text
