"""What every report page keeps to, whatever it is about."""

import re

MAX_BYTES = 5_000_000


def check_report_page(html):
    """Check contents, boxes of tables, figures that shrink, and that the page is one small file."""
    own = re.sub(r'srcdoc="[^"]*"', "", html)  # a replay is a page of its own
    headings = re.findall(r'<h[23] id="([^"]+)">', own)
    assert len(headings) > 2
    assert len(set(headings)) == len(headings)
    assert re.findall(r'<li class="level-[23]"><a href="#([^"]+)">', own) == headings
    assert not re.findall(r"<h[23]>(?!Contents)", own)
    assert own.count("<table") == own.count('<div class="scroll" tabindex="0"><table') > 0
    assert own.count("</table></div>") == own.count("<table")
    assert re.search(r"\.scroll \{[^}]*overflow-x: auto", own)
    assert re.search(r"img, svg \{ max-width: 100%; height: auto; \}", own)
    assert all("max-width: min(100%," in svg for svg in re.findall(r"<svg[^>]*>", own))
    assert own.count("<svg") > 0
    ids = re.findall(r' id="([^"]+)"', own)
    assert len(set(ids)) == len(ids)
    targets = re.findall(r'(?:href="#|url\(#)([^")]+)', own)
    assert set(targets) <= set(ids)
    assert not re.search(r'(?:src|href|data)="(?!data:|#|field_replay\.html")', own)
    assert not re.search(r"https?:|@import", own)
    assert len(html.encode()) < MAX_BYTES
