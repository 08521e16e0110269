"""Pages in a real browser, without a window: what tests of the report, the player and the docs look at."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
FLAGS = [
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
]

# What the page tells about itself once it has loaded.
PROBE = """<script>const errors = [];
window.addEventListener("error", e => errors.push(e.message));
window.addEventListener("load", () => {
  const seen = {
    images: [...document.images].map(i => [i.alt, i.complete, i.naturalWidth]),
    headings: [...document.querySelectorAll("h1,h2,h3")].map(h => h.innerText),
    empty: [...document.querySelectorAll("td,th,dd,figcaption")].filter(e => !e.textContent.trim()).length,
    wide: document.documentElement.scrollWidth - document.documentElement.clientWidth,
    errors: errors,
    cut: [...document.querySelectorAll(".wide")]
      .filter(e => e.offsetParent && e.scrollWidth > e.clientWidth + 1).length,
    shown: [...document.images].map(i => i.clientWidth),
    loaded: performance.getEntriesByType("resource").map(r => r.name).filter(n => !n.startsWith("data:")),
  };
  const out = document.createElement("script");
  out.type = "application/json"; out.id = "probe"; out.textContent = JSON.stringify(seen);
  document.body.append(out);
});</script>"""


def browse(page: Path, profile: Path, width: int = 1280, media: str = "screen") -> dict[str, Any]:
    """What `page` shows in a headless browser whose window is so wide, on a screen or as it is printed."""
    assert BROWSER is not None
    probed = page.with_name("probed.html")
    content = page.read_text(encoding="utf-8")
    if media == "print":
        content = content.replace("@media print", "@media screen")
    probed.write_text(re.sub(r"(<head[^>]*>)", lambda head: head[1] + PROBE, content, count=1), encoding="utf-8")
    options = [f"--user-data-dir={profile}", f"--window-size={width},900", "--virtual-time-budget=5000", "--dump-dom"]
    done = subprocess.run(
        [BROWSER, *FLAGS, *options, probed.as_uri()],
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
    )
    found = re.search(r'<script type="application/json" id="probe">(.*?)</script>', done.stdout, re.DOTALL)
    assert found, done.stdout[-500:]
    seen: dict[str, Any] = json.loads(found[1])
    return seen
