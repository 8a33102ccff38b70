"""What the site has besides docs/: pages of the repository, with links that lead where they did.

`mkdocs.yml` names it. A page of docs/ says `../examples/robot/README.md`, README.md
says `docs/start.md`; on the site both are one tree, in which README.md is the first page.
"""

import posixpath
import re
from pathlib import Path
from urllib.parse import urlsplit

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

REPO = Path(__file__).resolve().parent.parent
PAGES = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")
FOLDERS = ("examples", "results", "grids", "benchmarks")
"""Of whose files those are on the site that a page links to, or that are pages themselves."""
LINK = re.compile(r"(\]\()([^)\s]+)(\))")


def site_path(path: str) -> str:
    """Where a file of the repository is on the site, as a path in docs/."""
    return "index.md" if path == "README.md" else path.removeprefix("docs/")


def repo_path(path: str) -> str:
    """Where a file of the site is in the repository."""
    if path == "index.md":
        return "README.md"
    return path if path in PAGES or path.split("/")[0] in FOLDERS else f"docs/{path}"


def linked(text: str, source: str) -> set[str]:
    """Files of the repository that a page links to."""
    targets = (urlsplit(match[2]) for match in LINK.finditer(text))
    here = posixpath.dirname(source)
    return {
        posixpath.normpath(posixpath.join(here, url.path))
        for url in targets
        if url.path and not url.scheme
    }


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that are not in docs/, and what any page links to."""
    pages = [*PAGES, *(p.relative_to(REPO).as_posix() for p in sorted(REPO.glob("examples/*.md")))]
    for folder in ("examples", "results"):
        pages += [p.relative_to(REPO).as_posix() for p in sorted((REPO / folder).glob("*/*.md"))]
    pages = [name for name in pages if not name.endswith("table.md")]
    wanted = set(pages)
    for name in [*pages, *(f"docs/{p.name}" for p in (REPO / "docs").glob("*.md"))]:
        wanted |= linked((REPO / name).read_text(encoding="utf-8"), name)
    for name in sorted(wanted):
        if not name.startswith("docs/") and (REPO / name).is_file():
            path = site_path(name)
            files.append(
                File.generated(config, path, content=(REPO / name).read_bytes())
                if not name.endswith(".md")
                else File.generated(config, path, content=(REPO / name).read_text("utf-8"))
            )
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The page, with links from where it is on the site."""
    source = repo_path(page.file.src_uri)
    here, there = posixpath.dirname(source), posixpath.dirname(page.file.src_uri)

    def turned(match: re.Match[str]) -> str:
        url = urlsplit(match[2])
        if url.scheme or not url.path:
            return match[0]
        target = site_path(posixpath.normpath(posixpath.join(here, url.path)))
        path = posixpath.relpath(target, there or ".")
        return f"{match[1]}{url._replace(path=path).geturl()}{match[3]}"

    return LINK.sub(turned, markdown)
