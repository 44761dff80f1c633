"""Reads a page with html.parser: what it shows, its tables, and what is wrong with its structure."""

import re
from collections import Counter
from html.parser import HTMLParser

INTERVAL = re.compile(r"\[[\u2212+\d.]+, [\u2212+\d.]+\]")
VOID = {"meta", "br", "input", "path", "use", "rect"}


class Element:
    """An element with its attributes and contents."""

    def __init__(self, tag, attributes, parent):
        self.tag, self.attributes, self.parent, self.inside = tag, dict(attributes), parent, []

    @property
    def classes(self):
        """Names of its classes."""
        return (self.attributes.get("class") or "").split()

    def all(self, *tags):
        """Elements inside it in their order; all of them if no tags are given."""
        for each in self.inside:
            if isinstance(each, Element):
                if not tags or each.tag in tags:
                    yield each
                yield from each.all(*tags)

    @property
    def text(self):
        """Its text with single blanks."""
        parts = [each.text if isinstance(each, Element) else each for each in self.inside]
        return " ".join(" ".join(parts).split()) if self.tag not in ("sub", "sup") else "".join(parts)

    @property
    def shown(self):
        """Its text without style, script, what is folded and columns on demand."""
        if self.tag in ("style", "script", "title") or "more" in self.classes:
            return ""
        inside = [each for each in self.inside if self.tag != "details" or getattr(each, "tag", "") == "summary"]
        return " ".join(each.shown if isinstance(each, Element) else each for each in inside)


class Page(HTMLParser):
    """A page as a tree."""

    def __init__(self, text):
        super().__init__()
        self.root = self.here = Element("", (), None)
        self.feed(text)
        assert self.here is self.root, f"<{self.here.tag}> is not closed"

    def handle_starttag(self, tag, attributes):
        """Open an element."""
        assert len(attributes) == len(dict(attributes)), f"an attribute of <{tag}> stands twice"
        element = Element(tag, attributes, self.here)
        self.here.inside.append(element)
        if tag not in VOID:
            self.here = element

    def handle_startendtag(self, tag, attributes):
        """Add an element without contents."""
        self.here.inside.append(Element(tag, attributes, self.here))

    def handle_endtag(self, tag):
        """Close an element."""
        assert self.here.tag == tag, f"</{tag}> closes <{self.here.tag}>"
        self.here = self.here.parent

    def handle_data(self, data):
        """Add a text."""
        self.here.inside.append(data)

    def of_class(self, name):
        """Elements of a class."""
        return [each for each in self.root.all() if name in each.classes]

    @property
    def tables(self):
        """Tables that are not folded."""
        return [each for each in self.root.all("table") if not any(e.tag == "details" for e in above(each))]

    @property
    def folds(self):
        """Titles of the folds with what they say."""
        found = [each.inside[0] for each in self.of_class("fold")]
        return {next(each.all("b")).text: next(each.all("span")).text for each in found}

    def rows(self, table):
        """Texts of the cells of a table, row by row."""
        return [[cell.text for cell in row.all("th", "td")] for row in table.all("tr")]


def above(element):
    """Elements that contain an element."""
    while element.parent is not None:
        element = element.parent
        yield element


def faults(page, methods):
    """What is wrong with a page of some methods, in words."""
    found, body = [], next(page.root.all("body"))
    shown = " ".join(body.shown.split())
    order = [each for each in body.inside if isinstance(each, Element)]
    names = [each.tag if each.tag == "h1" else "".join(each.classes) for each in order[:3]]
    if [name for name in names if name != "banner"][:2] != ["h1", "answer"]:
        found.append(f"begins with {names}")
    if not any({"rows", "matrix"} & {*each.classes} for each in page.tables):
        found.append("no main table")
    if any(not each.attributes.get("scope") for each in page.root.all("th")):
        found.append("a head without scope")
    if any(n > 2 for n in Counter(INTERVAL.findall(shown)).values()):
        found.append("an interval stands more than twice")
    words = len(page.of_class("answer")[0].text.split())
    if words > 45:
        found.append(f"{words} words of the answer")
    heads = {row[0] for table in page.tables for row in page.rows(table)}
    heads |= {cell for table in page.tables for cell in page.rows(table)[0]}
    missing = [name for name in methods if not any(h == name or h.startswith((f"{name} ", f"{name},")) for h in heads)]
    if missing:
        found.append(f"no row of {missing}")
    if "not resolved" in body.text:
        found.append("not resolved")
    if any("hidden" in each.attributes for each in body.all()):
        found.append("hidden without a script")
    if [each for each in body.all() if {"src", "srcset", "onclick", "action"} & each.attributes.keys()]:
        found.append("loads or runs something")
    note = [each.text for each in page.of_class("note") if each.tag == "p"]
    if any(len(text) > 290 for text in note):
        found.append(f"a note of {max(map(len, note))} characters")
    return found
