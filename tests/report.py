"""Looks at a report as a reader does: headless Chromium, desktop and phone.

usage: report.py PAGE SCREENSHOTS. Prints what it found as JSON.
"""

import json
import sys
from pathlib import Path

import axe_core_python
from playwright.sync_api import sync_playwright

page_path, shots = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
axe = next(Path(axe_core_python.__file__).parent.glob("axe*.js")).read_text()
found = {"console": [], "requests": [], "violations": [], "hover": {}, "overflow": {}}
with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
    for name, width, scheme in [("desktop", 1280, "light"), ("phone", 390, "dark")]:
        context = browser.new_context(
            viewport={"width": width, "height": 844}, color_scheme=scheme, bypass_csp=name == "desktop"
        )
        page = context.new_page()
        page.on("console", lambda m: found["console"].append(m.text) if m.type != "log" else None)
        page.on("pageerror", lambda e: found["console"].append(str(e)))
        page.on("request", lambda r: found["requests"].append(r.url[:200]))
        page.goto(page_path.as_uri())
        page.screenshot(path=shots / f"{name}.png", full_page=True)
        point = page.locator("figure g.tt").first
        if point.count():
            # The first of the figure with the closure.
            point.scroll_into_view_if_needed()
            point.hover(force=True)
            found["hover"][name] = page.locator("#tip").inner_text()
            found["says"] = page.locator("figure g.tt").evaluate_all("all => all.map(g => g.dataset.says)")
        # Wider than the window is only what scrolls by itself.
        found["overflow"][name] = page.evaluate(
            "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        )
        if name == "desktop":
            for scheme in ["light", "dark"]:
                page.emulate_media(color_scheme=scheme)
                page.evaluate(axe)
                result = page.evaluate("axe.run()")
                found["violations"] += [
                    f"{v['id']} ({v['impact']}, {scheme}): {v['nodes'][0]['html'][:200]}"
                    for v in result["violations"]
                    if v["impact"] in ("serious", "critical")
                ]
    browser.close()
found["requests"] = [url for url in found["requests"] if not url.startswith(("file:", "data:"))]
print(json.dumps(found))
