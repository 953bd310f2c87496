"""The page of an evaluation: whole, escaped, alone; in a browser it fits, sorts and filters."""

import html
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import numpy as np
import pytest

from tests.benchmark.test_leaderboard import ALL, board, board_of
from tests.benchmark.test_report import EASY, records
from tracked_env.benchmark import leaderboard as lb
from tracked_env.benchmark import report as page
from tracked_env.benchmark.figures import profiles
from tracked_env.benchmark.leaderboard import MAX_DRAWN
from tracked_env.benchmark.store import READS_TRUTH
from tracked_env.benchmark.summary import summarise
from tracked_env.benchmark.table_model import colour, number_cell

ORIGIN = {
    "environment": "tracked_env/Torque-v0",
    "command": "tracked-env evaluate --sets " + "a_set_with_a_name_of_some_length_" * 8,
    "machine": "<i>two cores</i>",
}


class Checker(HTMLParser):
    """Balanced tags, and what is fetched from where."""

    def __init__(self):
        super().__init__()
        self.open = []
        self.sources = []
        self.seen = []

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.sources += [(tag, v or "") for k, v in attrs if k in ("src", "href", "data", "srcset")]
        if tag not in ("meta", "br", "img", "input"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in ("meta", "br", "img", "input"):
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def written(folder, draw=True, **rmse):
    """A page with every part but the figures of episodes."""
    given = [r for name in ("a", "b") for r in records(name, **(rmse or ALL))]
    found, rows = board_of(given)
    drawn = [profiles(found, rows["all sets"])] if draw else []
    path = page.write_leaderboard(folder, found, summarise(given), ORIGIN, drawn)
    return path.read_text(encoding="utf-8")


def test_the_page_is_whole_escaped_and_fetches_nothing(tmp_path):
    text = written(tmp_path, **{**ALL, "<b>&me": EASY})
    checker = Checker()
    checker.feed(text)
    assert checker.open == []
    assert not {"link", "img", "b", "i", "iframe"} & set(checker.seen)
    assert {source for tag, source in checker.sources if tag == "a"} >= {*page.FILES}
    others = [source for tag, source in checker.sources if tag != "a"]
    assert others and all(source.startswith("#") for source in others)  # parts of its figures
    assert not re.search(r"https?://|@import|url\((?!#)", text)
    assert "&lt;b&gt;&amp;me" in text and "&lt;i&gt;two cores" in text


def test_the_page_says_where_its_numbers_come_from(tmp_path):
    text = written(tmp_path, draw=False)
    assert "<h1>Leaderboard of <code>tracked_env/Torque-v0</code></h1>" in text
    for name, value in ORIGIN.items():
        assert f"<dt>{name}</dt><dd>{html.escape(value)}</dd>" in text


def test_the_page_without_figures_has_the_tables_with_intervals_as_text(tmp_path):
    text = written(tmp_path, draw=False)
    assert "<figure" not in text
    assert text.count('style="background:') == 5 * 2
    assert re.search(r"0\.\d\d \[0\.\d\d, 0\.\d\d\]<", text)
    assert text.count("<caption>") == text.count("<table") == 5
    heads = re.findall(r"<thead>.*?</thead>", text, flags=re.DOTALL)
    assert all("<th>" not in head and 'scope="col"' in head for head in heads)


def test_ratios_around_one_differ_in_colour_and_large_ones_still_do():
    ratios = [0.02, 0.1, 0.3, 0.6, 0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.5, 3.0, 10.0, 50.0]
    backs = [colour(ratio)[0] for ratio in ratios]
    assert len(set(backs)) == len(ratios) and colour(1.0)[0] == "#ffffff"
    shades = np.array([[int(b[i : i + 2], 16) for i in (1, 3, 5)] for b in backs], dtype=float)
    apart = np.abs(np.diff(shades, axis=0)).max(axis=1)
    assert apart[3:12].min() >= 15.0  # 5 % near 1 are seen
    assert all(blue > red for red, _, blue in shades[:8])
    assert all(red > blue for red, _, blue in shades[9:])


def _luminance(code):
    full = code if len(code) == 7 else "#" + "".join(2 * c for c in code[1:])
    parts = np.array([int(full[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(parts <= 0.03928, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_text_on_every_colour_of_the_scale_has_a_contrast_of_four_and_a_half():
    for ratio in np.geomspace(1e-3, 1e3, 601):
        one, other = sorted(map(_luminance, colour(float(ratio))))
        assert (other + 0.05) / (one + 0.05) >= 4.5, ratio


def test_cells_are_sorted_by_the_number_that_they_begin_with():
    texts = ("0.52 [0.49, 0.55]", "~12.1", "79.7%", "2.5e+04", "-", "too few", ">1000%")
    numbers = [0.52, 12.1, 79.7, 25e3, None, None, 1000.0]
    assert [number_cell(text).number for text in texts] == numbers


def test_figures_draw_five_agents_the_reference_and_both_ends_of_the_score_among_them():
    others = {f"z{i}": (0.5 + 0.01 * i) * EASY for i in range(6)}
    found, rows = board(**{**ALL, **others})
    shown = lb.figure_agents(found)
    assert len(shown) == MAX_DRAWN
    assert {"adaptive", "nominal", "oracle"} < set(shown)
    given = [r for name in ("a", "b") for r in records(name, **{**ALL, **others})]
    for record in given:  # another policy reads the truth, whatever its name
        record.pop(READS_TRUTH, None)
        if record["policy"] == "few@3":
            record[READS_TRUTH] = True
    assert "few" in lb.figure_agents(board_of(given)[0])
    svg = profiles(found, rows["all sets"]).svg
    assert all(f">{name}<" in svg for name in shown)


BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
needs_browser = pytest.mark.skipif(
    not BROWSER, reason="no Chromium is installed: the page is not seen in a browser"
)


def in_browser(folder, text, width, script):
    """What a script returns in the page (`w`: its window), in a frame of this width."""
    wrapper = folder / "wrapper.html"
    frame = html.escape(text, quote=True)
    wrapper.write_text(
        f'<iframe id="f" width="{width}" height="900" style="border:0" srcdoc="{frame}"></iframe>'
        '<script>document.getElementById("f").onload = (event) => {'
        "const f = event.target, w = f.contentWindow, d = w.document;"
        f"const found = (() => {{ {script} }})(); f.remove();"
        'document.title = "FOUND" + JSON.stringify(found) + "END"; };</script>',
        encoding="utf-8",
    )
    options = ["--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
    options += ["--window-size=1400,1000", "--virtual-time-budget=5000", "--dump-dom"]
    done = subprocess.run(
        [BROWSER, "--headless", *options, wrapper.as_uri()],
        **{"capture_output": True, "text": True, "timeout": 120, "check": True},
    )
    return json.loads(html.unescape(done.stdout.split("<title>FOUND")[1].split("END</title>")[0]))


@needs_browser
@pytest.mark.parametrize("width", [1280, 390])
def test_in_a_browser_nothing_is_wider_than_the_page_and_agent_and_verdict_stay_in_view(
    tmp_path, width
):
    name = "an-agent-with-a-name-that-is-very-long-and_without_any_place_to_break"
    text = written(tmp_path, **{**ALL, name: 2 * EASY})
    script = """
        const root = d.documentElement, pinned = [];
        for (const box of d.querySelectorAll(".scroll")) box.scrollLeft = 1e4;
        for (const each of d.querySelectorAll("#leaderboard tbody .pin0, #leaderboard tbody .pin1, "
             + "#sets tbody .pin0, #sets tbody .pin1")) {
          const at = each.getBoundingClientRect(), x = (at.left + at.right) / 2;
          each.scrollIntoView({block: "center"});
          const now = each.getBoundingClientRect();
          pinned.push([at.left, at.right, each.scrollWidth <= each.clientWidth + 1,
            each.contains(d.elementFromPoint(x, now.top + 8))]);
        }
        return {wide: root.scrollWidth, shown: root.clientWidth, pinned,
          scrolled: d.querySelector("#leaderboard .scroll").scrollLeft,
          requests: w.performance.getEntriesByType("resource").length};
    """
    found = in_browser(tmp_path, text, width, script)
    assert found["wide"] <= found["shown"] <= width
    assert found["requests"] == 0
    assert len(found["pinned"]) == 6 * 2 * 2
    for left, right, whole, on_top in found["pinned"]:
        assert 0 <= left < right < 0.6 * width and whole and on_top
    assert found["scrolled"] > 0 or width == 1280


@needs_browser
def test_in_a_browser_columns_sort_by_number_rows_filter_and_the_theme_changes(tmp_path):
    script = """
        const table = d.querySelector("#leaderboard table"), seen = {};
        const agents = () => [...table.tBodies[0].rows].filter((row) => !row.hidden)
          .map((row) => row.cells[0].textContent);
        const head = [...table.tHead.rows[0].cells].find((h) => h.textContent.includes("error"));
        seen.before = agents();
        head.querySelector("button").focus();
        seen.focused = d.activeElement === head.querySelector("button");
        const press = () => { d.activeElement.click(); return head.getAttribute("aria-sort"); };
        seen.rising = press(); seen.up = agents();
        seen.falling = press(); seen.down = agents();
        const field = d.querySelector("#leaderboard input");
        field.value = "ORACLE"; field.dispatchEvent(new w.Event("input"));
        seen.filtered = agents(); seen.said = d.querySelector("#leaderboard output").textContent;
        const back = () => w.getComputedStyle(d.body).backgroundColor, first = back();
        d.getElementById("theme").click(); seen.theme = [first, back()];
        return seen;
    """
    found = in_browser(tmp_path, written(tmp_path, draw=False), 1280, script)
    order = ["ppo", "oracle", "adaptive", "few *", "nominal"]
    assert found["before"] == found["up"] == order
    assert found["down"] == order[::-1]
    assert (found["rising"], found["falling"]) == ("ascending", "descending")
    assert found["focused"]
    assert (found["filtered"], found["said"]) == (["oracle"], "1 of 5 rows")
    assert found["theme"][0] != found["theme"][1]
