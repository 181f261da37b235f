"""Finds links of a built book that lead nowhere within it: `links.py FOLDER`."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    def __init__(self, path):
        super().__init__()
        self.links, self.anchors = [], set()
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.anchors.update(filter(None, (attrs.get("id"), attrs.get("name"))))
        link = attrs.get("href") if tag == "a" else attrs.get("src") if tag == "img" else None
        if link is not None:
            self.links.append(link)


def main(folder):
    folder = Path(folder).resolve()
    # The page for printing repeats all others, and the page for a wrong address has links from the site's root.
    paths = [path for path in folder.rglob("*.html") if path.name not in ("print.html", "404.html", "toc.html")]
    pages = {path: Page(path) for path in paths}
    broken, checked = [], 0
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            checked += 1
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if target.is_dir():
                target /= "index.html"
            anchor = unquote(parts.fragment)
            known = target in pages and (not anchor or anchor in pages[target].anchors)
            if not known and (target in pages or not target.is_file()):
                broken.append(f"{path.relative_to(folder)}: {link}")
    print(f"{len(pages)} pages, {checked} links within the book, {len(broken)} broken")
    sys.exit("\n".join(broken) or None)


main(sys.argv[1])
