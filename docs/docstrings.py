"""Docstrings for pages: Google style to Markdown, and the environments' Markdown to reStructuredText."""

from __future__ import annotations

import re
import textwrap

_SECTION = re.compile(r"^(Args|Raises|Returns|Yields|Example|Examples|Attributes|Version history):$")
_ROLE = re.compile(r":(?:py:)?(?:class|func|meth|mod|attr|data|exc):`~?([^`]+)`")
_ITEM = re.compile(r"^(\*{0,2}[\w, .`\"]+):\s(.*)$", re.S)
_BARS = re.compile(r"\|(?=\S)([^|`]*\S)\|")
_INLINE_BULLET = re.compile(r"(?<=\S) \* (?=`)")


def plain(text: str) -> str:
    """Inline markup of reStructuredText as Markdown's: roles and double backticks."""
    return _ROLE.sub(r"`\1`", text).replace("``", "`")


def google_to_markdown(text: str) -> str:
    """A docstring in Google style: its sections with bullets for arguments and fenced examples."""
    parts = []
    for title, body in _sections(text):
        if not title:
            parts.append(plain(body))
        elif title.startswith("Example"):
            shown = re.sub(r"\s*# doctest:.*", "", body)
            parts.append(f"**{title}**\n\n```pycon\n{shown}\n```")
        else:
            bullets = "\n".join(_bullet(entry) for entry in _entries(body))
            parts.append(f"**{title}**\n\n{plain(bullets)}")
    return "\n\n".join(part for part in parts if part)


def _sections(text: str) -> list[tuple[str, str]]:
    """(title, dedented body); the first has no title, nor has text that follows a section."""
    found: list[tuple[str, list[str]]] = [("", [])]
    for line in text.splitlines():
        match = _SECTION.match(line)
        if match:
            found.append((match[1], []))
            continue
        if found[-1][0] and line and not line.startswith(" "):
            found.append(("", []))
        found[-1][1].append(line)
    return [(title, textwrap.dedent("\n".join(lines)).strip("\n")) for title, lines in found]


def _entries(body: str) -> list[str]:
    """Entries of a section: a line that is not indented begins one."""
    entries: list[str] = []
    for line in body.splitlines():
        if line.startswith(" ") and entries:
            entries[-1] += " " + line.strip()
        elif line:
            entries.append(line)
    return entries


def _bullet(entry: str) -> str:
    match = _ITEM.match(entry)
    if match is None:
        return f"- {entry}"
    names = ", ".join(f"`{name.strip('`* ')}`" for name in match[1].split(","))
    return f"- {names}: {match[2]}"


def is_markdown(text: str) -> bool:
    """Whether a docstring is written in Markdown, as Gymnasium's environments' are."""
    return text.lstrip().startswith("## ")


def markdown_at(text: str, level: int) -> str:
    """A Markdown docstring whose headings begin at ``level``, with a line for each bullet."""
    deeper = re.sub(r"^## ", "#" * level + " ", plain(text), flags=re.M)
    return _INLINE_BULLET.sub("\n* ", deeper)


def escape_bars(line: str) -> str:
    """A line whose ``|x|`` reStructuredText does not take for a substitution."""
    return _BARS.sub(r"\\|\1\\|", line)


def markdown_to_rst(lines: list[str]) -> list[str]:
    """A Markdown docstring (headings, tables, bullets) as reStructuredText."""
    out: list[str] = []
    for line in _INLINE_BULLET.sub("\n* ", "\n".join(lines)).splitlines():
        previous = out[-1] if out else ""
        if line.startswith("## "):
            out += ["", f".. rubric:: {line[3:]}", ""]
        elif line.startswith("|"):
            out += _row(line, first=not previous.startswith("     "))
        elif line.startswith("* ") and previous and not previous.startswith(("* ", "  ")):
            out += ["", line]
        elif line and previous.startswith(("* ", "  ")) and not line.startswith(("* ", " ")):
            out.append("  " + line)  # a bullet goes on
        else:
            out.append(line)
    return out


def _row(line: str, first: bool) -> list[str]:
    """A table's row as one of a list-table, whose head comes before its first."""
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    if set("".join(cells)) <= set("-: "):
        return []  # the line below a table's head
    head = ["", ".. list-table::", "   :header-rows: 1", ""] if first else []
    return [*head, *(f"   {'* -' if i == 0 else '  -'} {cell}" for i, cell in enumerate(cells))]
