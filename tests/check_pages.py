"""Measures how the pages read: words, long sentences, and Flesch's reading ease.

python tests/check_pages.py prints a row for each page and what is above a bar.

    reading ease = 206.835 - 1.015 words / sentences - 84.6 syllables / words     (Flesch 1948)

Words are those written by hand: code, formulas and tables between marks (`<!-- x: begin -->`) or
included from `_generated` do not count. Cells of tables by hand count as words; sentences and
syllables are those of the text outside tables; code and formulas are one word of two syllables.
"""

import re
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
WORDS = 60_000  # of all pages together
PAGE_WORDS = 1_500
# By the beginning of the name: a page `own_` is one screen, NOTATION a table to look up.
BARS = {"README": 1_000, "own_": 350, "NOTATION": 2_500}
LONG_SENTENCE = 35  # words
LONG_SHARE = 0.05  # of the sentences of the user pages
EASE = 50.0
SEVERAL = re.DOTALL | re.MULTILINE
# History, and pages that only include one of the root.
LEFT_OUT = ("CHANGELOG", "decisions", "changelog", "contributing", "notation")
# Captions of index.md whose pages a user reads; the others are for study, reference and data.
USER = ("Start", "Environments", "Bring your own", "Train", "Compare", "Control and identify")


class Page(NamedTuple):
    """Counts of one page."""

    words: int
    sentences: int
    long: int  # sentences above LONG_SENTENCE words
    ease: float


def prose(text: str) -> tuple[str, str]:
    """The text without code, formulas and generated tables; and the tables that remain."""
    text = re.sub(r"<!-- (.+?): begin -->.*?<!-- \1: end -->", "", text, flags=re.DOTALL)
    text = re.sub(r"\A---\n.*?\n---\n|^(`{3,}).*?^\1$|<!--.*?-->", "\n", text, flags=SEVERAL)
    text = re.sub(r"^:::.*$|^\{\..+\}$|!\[[^\]]*\]\([^)]*\)", "", text, flags=re.MULTILINE)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]+`|\$\$.+?\$\$|\$[^$]+\$|https?://\S+", "item", text, flags=re.DOTALL)
    lines = text.split("\n")
    tables = [line for line in lines if line.lstrip().startswith("|")]
    return "\n".join(line for line in lines if line not in set(tables)), "\n".join(tables)


def sentences_of(text: str) -> list[list[str]]:
    """Words of each sentence; a heading or an item of a list ends one."""
    text = re.sub(r"^(#+ .*|\s*([-*]|\d+\.) )", r"\n\n\1", text, flags=re.MULTILINE)
    text = re.sub(r"^(#+ .*)$", r"\1\n", text, flags=re.MULTILINE)
    parts = re.split(r"\n\s*\n|[.?!](?=\W*\s|$)", text)
    found = ([word for word in part.split() if re.search(r"\w", word)] for part in parts)
    return [words for words in found if words]


def syllables(word: str) -> int:
    """Groups of vowels, less a silent e; a number counts as one."""
    letters = re.sub(r"[^a-z]", "", word.lower())
    letters = re.sub(r"(?<=[^l])e(?=s?$)|(?<=[^td])e(?=d$)", "", letters) or letters
    return max(len(re.findall(r"[aeiouy]+", letters)), 1)


def measured(text: str) -> Page:
    """Counts of a page."""
    body, tables = prose(text)
    sentences = sentences_of(body)
    words = [word for sentence in sentences for word in sentence]
    cells = [word for word in tables.split() if re.search(r"\w", word)]
    n, m = max(len(words), 1), max(len(sentences), 1)
    ease = 206.835 - 1.015 * n / m - 84.6 * sum(map(syllables, words)) / n
    return Page(len(words) + len(cells), m, sum(len(s) > LONG_SENTENCE for s in sentences), ease)


def pages() -> dict[str, Page]:
    """Every page by hand, by its path below docs/ without the suffix."""
    docs = ROOT / "docs"
    paths = [ROOT / f"{name}.md" for name in ("README", "NOTATION", "CONTRIBUTING")]
    paths += [path for path in sorted(docs.rglob("*.md")) if not path.match("docs/[_a]*/*.md")]
    names = {path: path.relative_to(docs if docs in path.parents else ROOT) for path in paths}
    return {
        str(name.with_suffix("")): measured(path.read_text(encoding="utf-8"))
        for path, name in names.items()
        if not str(name).startswith(LEFT_OUT)
    }


def user_pages() -> list[str]:
    """Pages in the menu of index.md that a user reads, and the two that have the menu."""
    blocks = re.findall(
        r"```\{toctree\}\n:caption: (.+?)\n.*?\n\n(.*?)```",
        (ROOT / "docs" / "index.md").read_text(encoding="utf-8"), flags=re.DOTALL,
    )  # fmt: skip
    return ["README", "index"] + [
        page for caption, block in blocks if caption.startswith(USER) for page in block.split()
    ]


def page_faults(found: dict[str, Page], users: list[str]) -> list[str]:
    """What is too long or too hard to read, page by page."""
    faults = []
    for name, page in found.items():
        bar = next((words for head, words in BARS.items() if name.startswith(head)), PAGE_WORDS)
        if page.words > bar:
            faults.append(f"{name}: {page.words} words, at most {bar}")
        if name in users and page.ease < EASE:
            faults.append(f"{name}: reading ease {page.ease:.0f}, at least {EASE:.0f}")
    return faults


def whole_faults(found: dict[str, Page], users: list[str]) -> list[str]:
    """The same of all pages together."""
    total = sum(page.words for page in found.values())
    share = sum(found[p].long for p in users) / sum(found[p].sentences for p in users)
    faults = [f"all pages: {total} words, at most {WORDS}"] * (total > WORDS)
    text = f"user pages: {share:.1%} long sentences, at most {LONG_SHARE:.0%}"
    return faults + [text] * (share > LONG_SHARE)


def main() -> int:
    """Print the table; the status is 1 where a bar is missed."""
    found, users = pages(), user_pages()
    print(f"{'page':32} {'words':>6} {'sentences':>9} {'long':>5} {'ease':>5}")
    for name, page in found.items():
        print(
            f"{name + ' *' * (name in users):32} {page.words:6} {page.sentences:9} "
            f"{page.long / page.sentences:5.0%} {page.ease:5.0f}"
        )
    print(f"{sum(page.words for page in found.values())} words by hand; user pages have a *")
    faults = page_faults(found, users) + whole_faults(found, users)
    print("\n".join(faults))
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
